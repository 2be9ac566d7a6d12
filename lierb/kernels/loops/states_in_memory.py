"""States of a looped plan, which are in memory. For other plans nothing happens."""

from __future__ import annotations

from typing import Any

from lierb.kernels.loops.record import Record
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import OK
from lierb.kernels.systems.system_of import in_memory
from lierb.kernels.tracing.trace import kernel


def keep_errors(plan: AnyPlan, body: Any, record: Record, now: Any) -> None:
    """Update the retained errors of a looped plan's joints, which are not in the record.

    now : 1 in the lanes to update.
    """
    if plan.is_looped:
        in_memory(plan).keep_errors(body, record.status == OK, now > 0.5)


def take_next(plan: AnyPlan, body: Any, mask: Any) -> None:
    """Make the next state the state where the mask, 1 or 0, is 1."""
    if plan.is_looped:
        in_memory(plan).take_next(body, mask)


def clear_errors(plan: AnyPlan, body: Any, mask: Any) -> None:
    """Set the retained errors of the joints to 0 where the mask is 1."""
    if plan.is_looped:
        in_memory(plan).clear_errors(body, mask)


def exchange(plan: AnyPlan, body: Any) -> None:
    """Exchange the state and the next one."""
    if plan.is_looped:
        in_memory(plan).exchange(body)


def copy_next(plan: AnyPlan, body: Any, mask: Any) -> None:
    """Copy the next state where the mask is 1, for `restore_next`."""
    if plan.is_looped:
        in_memory(plan).copy_next(body, mask)


def restore_next(plan: AnyPlan, body: Any, mask: Any) -> None:
    """Make the copy the next state where the mask is 1."""
    if plan.is_looped:
        in_memory(plan).copy_next(body, mask, is_back=True)


for _formula in (keep_errors, take_next, clear_errors, exchange, copy_next, restore_next):
    kernel(_formula)
