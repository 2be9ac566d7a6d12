"""Makes reference.npz: where the tops' centres of mass are at T_END, m, to the last digit.

heyoka's Taylor series in quadruple precision on the equations of the peers, one top at a time.
`python -m tolerances.reference` from bench/; needs heyoka, a few minutes. It prints how far the
extrapolation of `peers.reference`, in extended precision on other equations, is from that.
"""

from __future__ import annotations

import numpy as np
from peers import equations as eq
from peers import heavy_top as top
from peers import reference as other

from tolerances.tops import BATCHES, COUNT, REFERENCE, samples

CHECKED = 64  # tops that the extrapolation takes as well


def solved(omega0: np.ndarray) -> np.ndarray:
    """(n, 3) m."""
    import heyoka as hy

    variables = hy.make_vars("w", "x", "y", "z", "p", "q", "r")
    system = list(zip(variables, eq.reduced_rates(*variables), strict=True))
    integrator = hy.taylor_adaptive(
        system, [hy.real128(0.0)] * 7, fp_type=hy.real128, compact_mode=True
    )
    end, found = hy.real128(top.T_END), []
    for start in eq.reduced_start(omega0).T:
        integrator.time = hy.real128(0.0)
        integrator.state[:] = [hy.real128(x) for x in start.tolist()]
        integrator.propagate_until(end)
        found.append([float(x) for x in integrator.state])
    return eq.reduced_final(np.array(found).T).centre


def main() -> None:
    made = {}
    for batch in BATCHES:
        omega0 = samples(batch)
        if batch == "one":
            made[batch] = np.tile(solved(omega0[:1]), (COUNT, 1))
        else:
            made[batch] = solved(omega0)
        checked = other.solve(omega0[:CHECKED], 1500)[:, :3].astype(float)
        print(f"{batch}: {np.abs(checked - made[batch][:CHECKED]).max():.1e} m from another way")
    np.savez(REFERENCE, **made)


if __name__ == "__main__":
    main()
