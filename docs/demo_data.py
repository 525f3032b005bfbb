"""Write the data files of the demo, the video and the fit without noise: ``python docs/demo_data.py``.

The fit uses the same swing without a camera: the best approximation of a rope of 40 links by 10. It differs from the
rope divided into 10 links, because coarse links need more inertia and friction for the same motion.
"""

from hyperflex import files
from hyperflex.demo import twin


def main() -> None:
    """Film the swing, and fit it."""
    twin.film(twin.BUNDLED)
    mapped = {name: float(values[0]) for name, values in twin.fit(twin.exact()).values.items()}
    about = "what the demo's fit finds without a camera; made by docs/demo_data.py"
    files.write_toml(twin.MAPPED, {"source": "simulated", "about": about, "mapped": mapped})


if __name__ == "__main__":
    main()
