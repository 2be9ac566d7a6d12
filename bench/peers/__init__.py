"""Other ways to integrate the same heavy tops, each in one small file, run side by side.

A peer is a module of this package with

    FORMS : dict[str, Form]        what it can run: name → Form
    available() -> str             why it cannot run here; "" if it can
    config() -> dict[str, object]  versions, and the settings it runs at: its best
    run(form, omega0, accuracy, threads) -> Callable[[], Final]
                                   builds everything and gives back a function that integrates all
                                   tops once, from 0 to T_END, on so many threads

`accuracy` is the step in s, or the relative tolerance of a peer that chooses its own steps. What
`run` does is not timed; nor is the first call of what it returns, but both count as cold start.
`python -m peers` (from bench/, or `make bench-peers`) runs them all, each in a process of its own.
"""
