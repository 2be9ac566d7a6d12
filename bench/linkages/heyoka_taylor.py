"""heyoka: Taylor's method of high order on lanes, for Lagrange's equations of the double pendulum.

The equations are worked out for this one mechanism (`cases.harmonics`), its numbers are parameters
of each lane. Each batch chooses its own steps: a simulated second counts as the others' 1000.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from linkages import cases
from linkages.cases import Form, Tree

FORMS = {
    "chain2-1e-7": Form("chain2", "heyoka, Taylor, Lagrange's equations, 1e-7", 16384, dt=None),
    "chain2-1e-15": Form("chain2", "heyoka, Taylor, Lagrange's equations, 1e-15", 8192, dt=None),
}


def available() -> str:
    return "" if find_spec("heyoka") else "heyoka is not installed"


def config() -> dict[str, object]:
    import heyoka

    return {"heyoka": heyoka.__version__, "lanes": heyoka.recommended_simd_size()}


def run(form: str, tree: Tree) -> Callable[[], np.ndarray]:
    import heyoka as hy

    lanes, tolerance = hy.recommended_simd_size(), float(form.removeprefix("chain2-"))
    count = len(tree)
    padded = lambda rows: np.pad(rows, ((0, 0), (0, -count % lanes)), mode="edge").copy()
    start, numbers = (
        padded(np.concatenate([tree.q0, tree.v0], axis=1).T),
        padded(cases.harmonics(tree)),
    )
    integrator = hy.taylor_adaptive_batch(
        _equations(hy), np.zeros((4, lanes)), pars=np.zeros((17, lanes)), tol=tolerance,
        high_accuracy=False, compact_mode=False, fast_math=True,
    )  # fmt: skip

    def integrate() -> np.ndarray:
        found = np.empty_like(start)
        for i in range(0, start.shape[1], lanes):
            here = slice(i, i + lanes)
            integrator.set_time(0.0)
            integrator.state[:], integrator.pars[:] = start[:, here], numbers[:, here]
            integrator.propagate_until(cases.T_END)
            found[:, here] = integrator.state
        return cases.positions(tree.first(cases.CHECKED), found[:2, : cases.CHECKED].T)

    return integrate


def _equations(hy):
    """Lagrange's: d/dt ∂L/∂q̇ = ∂L/∂q with the mass matrix M(q₂) and the potential as series."""
    q1, q2, w1, w2 = hy.make_vars("q1", "q2", "w1", "w2")
    p = hy.par
    c1, s1, c, s = hy.cos(q1), hy.sin(q1), hy.cos(q2), hy.sin(q2)
    cc, ss = 2.0 * c * c - 1.0, 2.0 * s * c
    a = p[0] + p[1] * c + p[2] * s + p[3] * cc + p[4] * ss
    da = p[2] * c - p[1] * s + 2.0 * (p[4] * cc - p[3] * ss)
    b, db = p[5] + p[6] * c + p[7] * s, p[7] * c - p[6] * s
    x, y = p[9] + p[10] * c + p[11] * s, p[12] + p[13] * c + p[14] * s
    dx, dy = p[11] * c - p[10] * s, p[14] * c - p[13] * s
    v1 = c1 * y - s1 * x
    v2 = c1 * dx + s1 * dy + p[16] * c - p[15] * s
    f1 = -(da * w1 + db * w2) * w2 - v1
    f2 = 0.5 * da * w1 * w1 - v2
    determinant = a * p[8] - b * b
    return [
        (q1, w1), (q2, w2),
        (w1, (p[8] * f1 - b * f2) / determinant), (w2, (a * f2 - b * f1) / determinant),
    ]  # fmt: skip
