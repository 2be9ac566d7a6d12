"""A look into the machine code of the loop over steps: is it the SIMD code that it should be?"""

from __future__ import annotations

import re
from collections import Counter
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from cases import long_but

from lierb.compiler.code import OPTIONS
from lierb.kernels.loops.blocks import integrate_blocks
from lierb.kernels.loops.job import JOB
from lierb.kernels.systems.system_of import plan_of, takes_small_angle_steps
from lierb.kernels.tracing.cpu import DEFAULT_LANES, HAS_FMA, IS_X86
from lierb.methods import TABLEAUS
from lierb.model.joints.joint_type import JOINTS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (IS_X86 and HAS_FMA and DEFAULT_LANES >= 4),
        reason="the patterns are those of x86-64 with AVX and FMA",
    ),
]

# (joint, c-space, solver), and fused multiply–adds that one RK4 step takes on a pack at least:
# the coordinates of X and V times four stages and the end, and the solver's own.
PLANS = {
    "spherical": ("spherical", "SE3", "subgroup", 180),
    "revolute": ("revolute", "SE3", "subgroup", 45),
    "saddle": ("spherical", "SE3", "saddle", 180),
    "saddle_so3xr3": ("spherical", "SO3xR3", "saddle", 330),
}
LABEL = re.compile(r"(\.?\w+):")
JUMP = re.compile(r"\tj\w+\t(\.?\w+)")
OPERATION = re.compile(r"\t(\w+)")
PACKED_FMA = re.compile(r"vfn?m(add|sub)\d{3}pd")


def innermost_loops(assembly: str) -> list[list[str]]:
    """The operations of every loop that has no other inside, from its label to the jump back."""
    lines = assembly.splitlines()
    labels = {m[1]: i for i, line in enumerate(lines) if (m := LABEL.match(line))}
    spans = {
        (labels[m[1]], i)
        for i, line in enumerate(lines)
        if (m := JUMP.match(line)) and labels.get(m[1], i) < i
    }
    inner = [s for s in spans if not any(s[0] <= a and b <= s[1] and (a, b) != s for a, b in spans)]
    return [[m[1] for x in lines[a : b + 1] if (m := OPERATION.match(x))] for a, b in inner]


# Each is compiled here, whatever the disk cache has.
@pytest.fixture(scope="module", params=long_but(PLANS, "spherical", "saddle_so3xr3"))
def hot_loop(request) -> SimpleNamespace:
    """Counts of each operation in the loop over steps, and the expected number of FMAs."""
    joint, cspace, solver, expected = PLANS[request.param]
    method = TABLEAUS["RK4"]
    plan = plan_of(
        DEFAULT_LANES, rows=JOINTS[joint].rows, cspace=cspace, update="local",
        method=method.scheme(False, False), multipliers=False, solver=solver,
    )  # fmt: skip
    jobs = np.zeros(1, JOB)
    signature = tuple(
        map(numba.typeof, (plan, np.zeros((2, 2)), np.zeros(2, dtype=np.int64), jobs))
    )
    fresh = numba.njit(**OPTIONS)(integrate_blocks.py_func)  # Numba shows no code from its cache
    fresh.compile(signature)
    assembly = fresh.inspect_asm(signature)
    loops = [Counter(loop) for loop in innermost_loops(assembly)]
    # A step of these plans takes no root; a loop over blocks, which looks at starts, does.
    loops = [loop for loop in loops if not count(loop, "vsqrtpd")]
    if takes_small_angle_steps(plan):
        # The way of tiny angles: one branch, out of it, and the jump back.
        loops = [
            loop for loop in loops
            if count(loop, r"j\w+") == 2 and count(loop, "vmulpd")
            and not count(loop, "vdivpd")
        ]  # fmt: skip
    hottest = max(loops, key=lambda loop: count(loop, PACKED_FMA.pattern))
    return SimpleNamespace(
        assembly=assembly, operations=hottest, expected=expected, packs=plan.lanes // DEFAULT_LANES
    )


def count(loop: Counter, pattern: str) -> int:
    return sum(times for operation, times in loop.items() if re.fullmatch(pattern, operation))


def test_the_hot_loop_is_made_of_packed_multiply_adds(hot_loop):
    assert hot_loop.expected <= count(hot_loop.operations, PACKED_FMA.pattern) / hot_loop.packs


def test_the_hot_loop_computes_on_packs_only(hot_loop):
    """Scalars are broadcast (constants, the step), never computed with."""
    scalar = r"v(add|sub|mul|div|sqrt|min|max|fn?m(add|sub)\d{3})sd"
    assert count(hot_loop.operations, scalar) == 0


def test_the_hot_loop_calls_nothing(hot_loop):
    assert count(hot_loop.operations, r"callq?") == 0


def test_the_hot_loop_fuses_more_than_it_multiplies(hot_loop):
    """Products that are not fused are those that have nothing to be added to."""
    loop = hot_loop.operations
    assert count(loop, PACKED_FMA.pattern) > count(loop, "vmulpd")


def test_packs_that_leave_the_registers_stay_within_cache_lines(hot_loop):
    assert re.search(r"andq\t\$-(64|128), %rsp", hot_loop.assembly)
