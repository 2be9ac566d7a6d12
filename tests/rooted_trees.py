"""Order conditions of Runge–Kutta methods by rooted trees, in 40 digits.

A tree is the sorted tuple of its root's subtrees; () is the single node. The condition of a tree τ
of n nodes, at θ of a step, is Φ(τ) = θⁿ/γ(τ), Φ its elementary weight, γ its density (Hairer,
Nørsett, Wanner, Solving ODEs I, II.2 and II.6).
"""

import math
from collections import Counter
from functools import cache
from itertools import combinations_with_replacement

from mpmath import mp, mpf

DIGITS = 40


def _partitions(total, largest):
    if total == 0:
        yield ()
    for first in range(min(total, largest), 0, -1):
        for rest in _partitions(total - first, first):
            yield (first, *rest)


@cache
def trees(nodes):
    found = set()
    for sizes in _partitions(nodes - 1, nodes - 1):
        forests = [()]
        for size, count in Counter(sizes).items():
            forests = [
                (*forest, *more)
                for forest in forests
                for more in combinations_with_replacement(trees(size), count)
            ]
        found.update(tuple(sorted(forest)) for forest in forests)
    return sorted(found)


def nodes_of(tree):
    return 1 + sum(map(nodes_of, tree))


def density(tree):
    return nodes_of(tree) * math.prod(map(density, tree))


class Stages:
    """The elementary weights of a method's stages, each found once."""

    def __init__(self, A):
        self.A = [[mpf(a) for a in row] for row in A]
        self._values, self._sums = {}, {}

    def values(self, tree):
        """gᵢ(τ) = Πₖ Σⱼ Aᵢⱼ gⱼ(τₖ), for each stage."""
        if tree not in self._values:
            product = [mpf(1)] * len(self.A)
            for child in tree:
                product = [x * y for x, y in zip(product, self._summed(child), strict=True)]
            self._values[tree] = product
        return self._values[tree]

    def _summed(self, tree):
        if tree not in self._sums:
            values = self.values(tree)
            self._sums[tree] = [_dot(row, values) for row in self.A]
        return self._sums[tree]

    def weight(self, tree, b):
        """Φ(τ) = Σᵢ bᵢ gᵢ(τ)."""
        return _dot([mpf(x) for x in b], self.values(tree))


def _dot(weights, values):
    return mp.fsum(w * x for w, x in zip(weights, values, strict=False) if w)


def defect(stages, b, order, theta=1):
    """Largest residual, in doubles, of the conditions of the trees of `order` nodes."""
    with mp.workdps(DIGITS):
        return max(
            float(abs(stages.weight(tree, b) - mpf(theta) ** order / density(tree)))
            for tree in trees(order)
        )


def worst_defect(stages, b, order, theta=1):
    """Largest residual of all conditions up to that order."""
    return max(defect(stages, b, n, theta) for n in range(1, order + 1))


def weights_at(dense, theta):
    """bᵢ(θ) of a continuous extension."""
    with mp.workdps(DIGITS):
        powers = [mpf(theta) ** k for k in range(1, len(dense[0]) + 1)]
        return [_dot([mpf(x) for x in row], powers) for row in dense]


class RosenbrockStages(Stages):
    """The elementary weights of a Rosenbrock method in its standard form.

    With Γ = (1/γ − C)⁻¹ the edges at a node of one subtree have β = AΓ + Γ, those at a node of
    several have α = AΓ (Hairer and Wanner, Solving ODEs II, IV.7, theorem 7.4).
    """

    def __init__(self, tableau):
        with mp.workdps(DIGITS):
            n = tableau.stages
            self.gammas = (mp.eye(n) / mpf(tableau.gamma) - _square(tableau.C)) ** -1
            alpha = _square(tableau.A) * self.gammas
            super().__init__(alpha.tolist())
            self.B = (alpha + self.gammas).tolist()

    def values(self, tree):
        if len(tree) == 1 and tree not in self._values:
            below = self.values(tree[0])
            self._values[tree] = [_dot(row, below) for row in self.B]
        return super().values(tree)

    def weight(self, tree, b):
        """Φ(τ) for weights b of the tableau's kᵢ."""
        standard = mp.matrix([list(map(mpf, b))]) * self.gammas
        return _dot(list(standard), self.values(tree))


def _square(rows):
    matrix = mp.zeros(len(rows))
    for i, row in enumerate(rows):
        for j, number in enumerate(row):
            matrix[i, j] = mpf(number)
    return matrix
