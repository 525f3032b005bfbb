from hyperflex.demo.report import DemoReport as DemoReport
from hyperflex.demo.report import write_demo as write_demo
