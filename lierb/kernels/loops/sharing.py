"""Share the trajectories of a run among threads, and gather their input numbers."""

from __future__ import annotations

from numba import prange

from lierb.compiler.code import cached
from lierb.compiler.entries import call, raise_again, take_turns
from lierb.compiler.loops import histories_at, integers_at, number_at, shared

SHARES = 8  # initially, number of parts into which an even share of a thread is divided


@shared
def take_share(counter, count, threads):
    """Return the next share of range(count) for a thread: its first number, and one past its last.

    Shares shrink, so that all threads end together on cores of different speed. A share is
    contiguous: two threads that write to neighbouring columns wait for each other, in short runs
    for as long as the work takes.
    """
    size = max((count - counter[0]) // (SHARES * threads), 1)
    first = take_turns(counter, size)
    return first, min(first + size, count)


@shared
def pack(job, inputs, first, is_new):
    """Gather a block's input numbers; lanes past the last trajectory repeat its numbers.

    is_new : True if `inputs` does not yet have the numbers that all trajectories share.
    """
    addresses, varying = integers_at(job.addresses), integers_at(job.varying)
    begin, last = job.first + first, job.stop - job.first - first - 1
    for i in range(inputs.shape[0] if is_new else varying.shape[1]):
        c = i if is_new else varying[0, i]
        stride = addresses[c, 1]
        address = addresses[c, 0] + stride * begin
        for lane in range(inputs.shape[1]):
            inputs[c, lane] = number_at(address)
            address += stride if lane < last else 0


@cached(parallel=True)
def integrate_on_threads(integrate, counter, threads, jobs):
    """Run `integrate`, an entry of compiled code, on every thread; this loop serves all plans.

    jobs : [thread][record].
    """
    for thread in prange(threads):
        own = jobs[thread]
        inputs = histories_at(own[0].inputs)[thread]
        raised = call(integrate, inputs, counter, own)
        if raised != 0:
            counter[1] = raised
    raise_again(counter[1])
