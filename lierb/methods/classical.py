"""These methods are for fixed steps, as they have no error estimate."""

from lierb.methods.tableau import ButcherTableau

METHODS = (
    ButcherTableau([[]], [1], name="Euler", order=1, source="Euler, Institutiones (1768)"),
    ButcherTableau(
        [[], [1 / 2]], [0, 1], name="Midpoint", order=2, source="Runge, Math. Ann. 46 (1895)"
    ),
    ButcherTableau(
        [[], [1]], [1 / 2, 1 / 2], name="Heun", order=2, source="Heun, Z. Math. Phys. 45 (1900)"
    ),
    ButcherTableau(
        [[], [2 / 3]],
        [1 / 4, 3 / 4],
        name="Ralston",
        order=2,
        source="Ralston, Math. Comp. 16 (1962)",
    ),
    ButcherTableau(
        [[], [1], [1 / 4, 1 / 4]],
        [1 / 6, 1 / 6, 2 / 3],
        name="SSP33",
        order=3,
        source="Shu and Osher, J. Comput. Phys. 77 (1988), strong stability preserving",
    ),
    ButcherTableau(
        [[], [1 / 2], [-1, 2]],
        [1 / 6, 2 / 3, 1 / 6],
        name="Kutta3",
        order=3,
        source="Kutta, Z. Math. Phys. 46 (1901)",
    ),
    ButcherTableau(
        [[], [1 / 2], [0, 1 / 2], [0, 0, 1]],
        [1 / 6, 1 / 3, 1 / 3, 1 / 6],
        name="RK4",
        order=4,
        source="Kutta, Z. Math. Phys. 46 (1901)",
    ),
    ButcherTableau(
        [[], [1 / 3], [-1 / 3, 1], [1, -1, 1]],
        [1 / 8, 3 / 8, 3 / 8, 1 / 8],
        name="RK38",
        order=4,
        source="Kutta, Z. Math. Phys. 46 (1901), the 3/8 rule",
    ),
)
