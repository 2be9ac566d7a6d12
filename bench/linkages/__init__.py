"""Other ways to integrate the same mechanisms, each in one small file, run side by side.

A peer is a module of this package with

    FORMS : dict[str, Form]        what it can run: name → Form
    available() -> str             why it cannot run here; "" if it can
    config() -> dict[str, object]  versions, and the settings it runs at: its best
    run(form, tree) -> Callable[[], np.ndarray]
                                   builds everything and gives back a function that integrates all
                                   trajectories once on one core, from 0 to T_END, to where the
                                   links are: (n, links, 3) m

Every trajectory has masses, inertias, frames and initial values of its own: one model a sample.
What `run` does is not timed. `python -m linkages` (from bench/, or `make bench-peers`) runs them
all, each in a process of its own, and shows no time of a peer whose motion is another.
"""
