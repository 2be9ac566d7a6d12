"""Motion of a tree in memory, and that of its elements, at a stage or a state."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from lierb.kernels.functions.signals import Signals
from lierb.kernels.mechanics import tree_nodes
from lierb.kernels.mechanics.kinks import TIGHT, Bound
from lierb.kernels.mechanics.newton_euler import Motion
from lierb.kernels.mechanics.tree import HERE
from lierb.kernels.mechanics.tree_connections import between, frame_on
from lierb.kernels.mechanics.tree_nodes import Kind
from lierb.kernels.numbers.arithmetic import minimum, sqrt, where
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.connection_table import TRAVEL
from lierb.kernels.systems.plan import ElementKind
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_loop_rows import LoopRows
from lierb.kernels.systems.tree_memory import LoopBody, MemoryElement, MemoryNode, MemoryTree
from lierb.kernels.systems.tree_table import slopes_of
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.memory import Rows, for_each, if_not_zero

INF = float("inf")


class LoopMotion(NamedTuple):
    """Motion of a tree, that of whose nodes is in memory.

    of_listed : relative motion of each listed element.   is_next : True for the next state.
    """

    of_listed: tuple[Motion, ...]
    is_next: bool = False


class LoopMotions(LoopRows):
    """Motions of nodes and elements, and bounds on steps that follow from them."""

    def _call_place(
        self, tree: MemoryTree, ahead: Index, is_whole: bool, of_next: bool = False
    ) -> None:
        """Emit a call of the outward pass at X and V of the stage, which stores Ẋ.

        of_next : whether to begin at the charts to which a step leads.
        """
        whole, behind = tree.index(int(is_whole)), tree[at.AHEAD] if of_next else tree.index(0)
        self._run("place", tree, self._place, ahead, whole, behind)

    def _place(self, tree: MemoryTree, ahead: Index, whole: Index, behind: Index) -> None:
        def one(node: MemoryNode) -> None:
            chart = tree.rows(node.entry(at.CHART) + behind)
            parts = (node.constants, chart, node.freedoms(at.X_ROW))
            v, into = node.freedoms(at.STAGE_ROW), node.slopes(at.X_SLOPES, ahead)
            above, here = node.above, node.motion

            def do(kind: Kind) -> None:
                into.put(0, *tree_nodes.place(kind, *parts, v, above, here))
                place = partial(tree_nodes.place_origin, kind, node.constants, v, above, here)
                if_not_zero(whole, place)

            node.each_kind(do)

        tree.for_nodes(one)

    def _spare(self, tree: MemoryTree) -> Index:
        """Rows of all slopes of a step, behind which those of a state at rest are."""
        return tree[at.FREEDOMS] * slopes_of(self.plan)

    def _stay(self, tree: MemoryTree, is_next: bool = False) -> None:
        """Make the state, or the next one, the stage."""
        x, stage = tree.section(at.X_ROW), tree.section(at.STAGE_ROW)
        v = tree.rows(tree[at.V_ROW] + tree[at.AHEAD]) if is_next else tree.section(at.V_ROW)

        def copy(i: Index) -> None:
            x.put(i, 0.0)
            stage.put(i, v[i])

        for_each(tree[at.FREEDOMS], copy)

    def motion(self, body: LoopBody, state: State, time: Any, is_next: bool = False) -> LoopMotion:
        """Store the motion of the nodes at the state or the next one; return that of elements."""
        tree = self._tree(body)
        self._see(tree, is_next)
        return LoopMotion(self._of_listed(body), is_next)

    def _see(self, tree: MemoryTree, is_next: bool) -> None:
        """Store the motion of the nodes at the state or the next one."""
        self._stay(tree, is_next)
        self._call_place(tree, self._spare(tree), is_whole=True, of_next=is_next)

    def _of_listed(self, body: LoopBody) -> tuple[Motion, ...]:
        """Return the motions of the plan's listed elements, from those of the nodes in memory."""
        tree, motions = self._tree(body), []
        for k, frames in enumerate(body.frames):
            (inner, outer), at_ends = frames or (HERE, HERE), tree.listed(k)
            frame = frame_on(at_ends.node.motion, inner)
            motions.append(between(outer, frame, at_ends.other.motion, ZERO)[0])
        return tuple(motions)

    def motions(self, body: LoopBody, motion: LoopMotion, time: Any) -> Callable[[int], Motion]:
        first = len(self.plan.elements) - len(motion.of_listed)
        return lambda i: motion.of_listed[i - first]._replace(time=time, signals=body.signals)

    def jumps(self, body: LoopBody) -> tuple[Any, ...]:
        """Times at which elements may jump, s."""
        return body.jumps

    def travel(
        self,
        body: LoopBody,
        start: LoopMotion,
        end: LoopMotion,
        time: Any,
        h: Any,
        watched: type | None,
    ) -> tuple[Bound, ...]:
        """Bounds on a step's length; see `PassiveElements.travel`.

        Those of all elements that act are one bound.
        """
        listed = [e for e in self.plan.elements if e.is_listed]
        first, size = len(self.plan.elements) - len(listed), sqrt(body.girth)
        before, after = (self.motions(body, motion, time) for motion in (start, end))
        bounds = list[Bound]()
        for i, e in enumerate(listed, first):
            if isinstance(e, watched) if watched else e.bounds_steps:
                begin = before(i)
                last = begin if end is start else after(i)
                bounds += e.travel(body.elements[i], begin, last, h, size)
        if watched or not any(kind.element.bounds_steps for kind in self.plan.element_kinds):
            return tuple(bounds)
        tree, is_kept = self._tree(body), end is not start
        best = tree.section(at.SUMS_ROW)
        best.put(0, INF, INF)
        self._see(tree, start.is_next)
        if is_kept:
            tree.for_elements(_keep_motion)
            self._see(tree, end.is_next)
        tree.for_elements(partial(_bound, best, h, size, body.signals, is_kept))
        return (*bounds, Bound(1.0, best[0], INF), Bound(1.0, best[1], TIGHT))


def _bounding(do: Callable[[ElementKind], None], kind: ElementKind) -> None:
    if kind.element.bounds_steps:
        do(kind)


def _kept_motion(element: MemoryElement) -> Rows:
    return element.tree.rows(element.tree[at.TRAVEL_ROW] + element.k * TRAVEL)


def _keep_motion(element: MemoryElement) -> None:
    """Store an element's motion."""

    def do(kind: ElementKind) -> None:
        _, _, x, _ = element.placed(kind, ZERO)
        _kept_motion(element).put(0, *x.q, *x.place, *x.omega, *x.v)

    element.each_kind(partial(_bounding, do))


def _bound(
    best: Rows, h: Any, size: Any, signals: Signals, is_kept: bool, element: MemoryElement
) -> None:
    """Lower the longest step, and the longest that may have been made, by an element's bounds.

    signals : at the start of the step.   is_kept : whether the element's motion there is stored.
    """

    def do(kind: ElementKind) -> None:
        placed, _, end, _ = element.placed(kind, ZERO)
        start = end = end._replace(signals=signals)
        if is_kept:
            rows = _kept_motion(element)
            start = Motion(ZERO, rows[0:9], rows[9:12], rows[12:15], rows[15:18])
            start = start._replace(signals=signals)
        for rate, distance, slack in kind.element.travel(placed, start, end, h, size):
            if not is_zero(rate):
                longest = where(rate > 0.0, distance / where(rate > 0.0, rate, 1.0), INF)
                # the second number as if all slacks were TIGHT
                accepted = (slack / TIGHT) * longest
                best.put(0, minimum(best[0], longest), minimum(best[1], accepted))

    element.each_kind(partial(_bounding, do))
