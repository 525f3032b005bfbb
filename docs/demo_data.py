"""Film the demo's video: ``python docs/demo_data.py``."""

from hyperflex.demo import twin

if __name__ == "__main__":
    twin.film(twin.BUNDLED)
