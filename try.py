import hyperflex as hf, time, os, threading, traceback, pathlib, resource, sys
import numpy as np
resource.setrlimit(resource.RLIMIT_AS,(4<<30,4<<30))
from hyperflex import files
os.chdir("/tmp/rd")
def t(name, f):
    a=time.process_time()
    try: r=f(); s="OK "+repr(r)[:150]
    except hf.HyperflexError as e: s=f"{type(e).__name__}: {str(e)[:400]}"
    except BaseException as e: s="LEAK "+type(e).__name__+": "+str(e)[:200]
    print(f"[{name}] {time.process_time()-a:.2f}s {s}", flush=True)
p=pathlib.Path("x.toml")
def toml(text):
    p.write_text(text); return hf.Setup.from_toml(p)
t("deep", lambda: toml("[rope]\nlength = "+"["*5000+"]"*5000+"\n"))
t("inline", lambda: toml("rope = "+"{a="*3000+"1"+"}"*3000+"\n"))
t("bigint", lambda: toml("duration = "+"9"*5000+"\n[rope]\nn_links=5\nlink_length=0.4\nlink_mass=0.1\n"))
t("bigint400", lambda: toml("duration = "+"9"*400+"\n[rope]\nn_links=5\nlink_length=0.4\nlink_mass=0.1\n"))
t("dotted", lambda: toml("a"+".a"*2000+" = 1\n"))
R="[rope]\nn_links=5\nlink_length=0.4\nlink_mass=0.1\n"
t("unknown", lambda: toml("durations = 1.0\n"+R))
t("wrong table", lambda: toml(R+"duration = 3\n"))
t("rope table in arm", lambda: toml(R+"[arm]\nlength=0.1\nfriction=1\nt_move=0.3\n"))
t("motion", lambda: toml(R+"[arm]\nlength=0.1\n[motion]\nkind='swings'\nt_mov=0.3\n"))
t("pegs", lambda: toml(R+"[pegs]\nx=1.0\ny=1.0\nradius=0.1\nmy=0.1\n"))
t("peg", lambda: toml(R+"[peg]\nx=1.0\ny=1.0\nradius=0.1\nmy=0.1\n"))
c=pathlib.Path("x.csv")
def csv(text, **k):
    c.write_text(text); return hf.read_recording(c, **{**dict(time_unit="s",unit="rad"),**k})
t("gap at the end", lambda: csv("t,th1,th2\n0,0.1,0.2\n0.1,0.2,0.3\n0.2,0.1,"))
t("frame", lambda: csv("frame,t,th1\n0,0,0.1\n1,0.1,0.2\n2,0.2,0.3\n"))
t("frameonly", lambda: csv("frame,th1\n0,0.1\n1,0.2\n2,0.3\n",time_unit="frame",frame_rate=30))
t("#columns", lambda: csv("# columns: t,th1\n0,0.1\n0.1,0.2\n0.2,0.3\n"))
t("#cols", lambda: csv("# t th1\n0 0.1\n0.1 0.2\n0.2 0.3\n"))
t("spaces", lambda: csv("t th1\n0 0.1\n0.1 0.2\n0.2 0.3\n"))
t("NA", lambda: csv("t,th1\n0,0.1\n0.1,NA\n0.2,0.3\n"))
t("-", lambda: csv("t,th1\n0,0.1\n0.1,-\n0.2,0.3\n"))
t("1_000", lambda: csv("t,th1\n0,0.1\n0.1,1_000\n0.2,0.3\n"))
t("time", lambda: csv("t,th1\n0,0.1\n0.2,0.1\n0.1,0.3\n"))
t("time gap", lambda: csv("t,th1\n0,0.1\n,0.1\n0.1,0.3\n"))
t("pegs=Peg", lambda: hf.Setup(hf.Rope.uniform(1,1,3), pegs=hf.Peg(1,1,.1)))
t("q0=0.5", lambda: hf.simulate(hf.Rope.uniform(1,1,3), q0=0.5, duration=0.1))
t("radius", lambda: hf.Rope.uniform(2,1,3,radius=5))
t("free=3", lambda: hf.identify(hf.Recording([0,.1,.2],[[0.],[0.1],[0.]]),hf.Rope([1.],[1.]),free=3))
