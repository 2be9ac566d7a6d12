"""Growth of the warm process's memory over one call, beyond what goes in and comes out."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import ctypes, sys
sys.path[:0] = {path!r}
from bench_integrate import integrated, problem_of


def status(field):
    with open("/proc/self/status") as lines:
        (line,) = [line for line in lines if line.startswith(field)]
    return int(line.split()[1]) * 1024


options = dict(save_every=10, record=("state", "energy")) if {history} else dict()
integrated(problem_of("spherical", "tilted", 64), steps=100, **options)()
run = integrated(problem_of("spherical", "tilted", {bodies}), steps=100, **options)
ctypes.CDLL(None).malloc_trim(0)  # what making the problem left behind is no room to hide in
with open("/proc/self/clear_refs", "w") as marks:
    marks.write("5")  # the peak counts from here
before = status("VmRSS")
result = run()
outputs = sum(table.nbytes for table in (result.summary, result.history) if table is not None)
outputs += result._end.output.ends.nbytes  # with which a run goes on
print(status("VmHWM") - before - outputs)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("history", [False, True])
@pytest.mark.parametrize("bodies", [10_000, 100_000, 400_000])
def test_growth(bodies, history, benchmark):
    program = PROGRAM.format(path=sys.path[:4], bodies=bodies, history=history)

    def run():
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True
        )
        benchmark.extra_info["growth_MB"] = round(int(done.stdout) / 1e6, 1)

    benchmark.pedantic(run, rounds=1, iterations=1)
