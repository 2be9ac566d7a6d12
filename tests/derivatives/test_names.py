"""Names, shapes, units and errors of derivatives, and their tables."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from cases import top

import lierb
from derivatives.test_of_mechanisms import double_pendulum
from lierb.errors import ArgumentError, UnknownNameError
from lierb.runs.parameters import parameters_by_name

RUN = {"dt": 1e-2, "t_end": 0.1}
# All that the tests of one body differentiate and record, so that they share a kernel.
NAMES = ("omega0", "gravity")
ROWS = {"save_every": 5, "record": ("state", "multipliers", "reaction"), "with_respect_to": NAMES}


def spun(**options) -> lierb.Result:
    problem, twist = top()
    return lierb.integrate(problem, twist0=twist, **(RUN | options))


def swung(**options) -> lierb.Result:
    pendulum = double_pendulum()
    start = {"pose0": pendulum.pose({"upper": 1.0}), "twist0": pendulum.twist({"lower": 1.0})}
    return lierb.integrate(pendulum, **start, **(RUN | options))


# ---- names -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "size", "unit"),
    [
        ("omega0", 3, "rad/s"), ("twist0", 6, "rad/s, rad/s, rad/s, m/s, m/s, m/s"),
        ("pose0", 6, "rad, rad, rad, m, m, m"), ("gravity", 3, "m/s²"), ("body.mass", 1, "kg"),
        ("body.com", 3, "m"), ("body.inertia", 6, "kg m²"), ("joint.body_point", 3, "m"),
        ("joint.ground_point", 3, "m"),
    ],
)  # fmt: skip
def test_every_parameter_has_a_size_and_a_unit(name, size, unit):
    from lierb.runs.parameters import chosen_parameters

    (parameter,) = chosen_parameters(top()[0], name)
    assert (parameter.name, parameter.size, parameter.unit) == (name, size, unit)


def test_elements_have_the_names_of_their_columns():
    from lierb.runs.parameters import chosen_parameters

    springs = [lierb.forces.spring_damper(stiffness=k) for k in (1.0, 2.0)]
    problem = lierb.Problem(
        lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.free(),
        forces=[*springs, lierb.forces.drag(linear=0.1)],
    )  # fmt: skip
    names = ("spring_damper_2.stiffness", "drag.linear", "spring_damper_1.body_point")
    parameters = chosen_parameters(problem, names)
    assert [p.fields for p in parameters] == [("1.stiffness",), ("2.linear",), ("0.body_point",)]
    assert [p.unit for p in parameters] == ["N/m", "N s/m", "m"]
    # as in a study
    (same,) = chosen_parameters(problem, "forces.drag.linear")
    assert same.fields == ("2.linear",)
    assert chosen_parameters(problem, "problem.gravity")[0].name == "gravity"


def test_units_of_motors_and_gears_are_those_of_their_coordinates():
    body = lierb.bodies.sphere(0.1, mass=1.0)
    rail = lierb.Problem(body, lierb.joints.prismatic(), forces=lierb.forces.motor(position=0.1))
    rack = lierb.Mechanism(
        [lierb.Link("pinion", body, lierb.joints.revolute()),
         lierb.Link("rack", body, lierb.joints.prismatic())],
        forces=lierb.forces.gear(2.0).on("rack", "pinion"),
    )  # fmt: skip
    assert parameters_by_name(rail)["motor.position"].unit == "m"
    assert parameters_by_name(rack)["rack.gear.ratio"].unit == "m/rad"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("body.masss", "Did you mean 'body.mass'"),
        ("dt", "is unknown; choose from twist0, omega0"),
        ("joint.pitch", "is unknown"),  # a spherical joint has none
        ("rod.body.mass", "is unknown"),
        (3, r"with_respect_to=3; expected names"),
        ([1.0], "has 1.0; expected names of parameters"),
        (["omega0", "omega0"], "names omega0 twice"),
        (["gravity", "problem.gravity"], "names gravity twice"),
    ],
)
def test_names_that_are_no_parameters_are_refused(given, message):
    with pytest.raises(ArgumentError if "expected" in message or "twice" in message
                       else UnknownNameError, match=message):  # fmt: skip
        spun(with_respect_to=given)


def test_a_joint_with_a_pitch_has_it_as_a_parameter():
    from lierb.runs.parameters import chosen_parameters

    screw = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.screw(pitch=0.1))
    (pitch,) = chosen_parameters(screw, "joint.pitch")
    assert (pitch.size, pitch.unit, pitch.fields[0]) == (1, "m/rad", "pitch")


# ---- refusals ----------------------------------------------------------------------------------


@lierb.wrench(stop=1.0, discontinuities="stop")
def burn(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), (lierb.where(t < params.stop, 1.0, 0.0), 0.0, 0.0)


def free_body(**more) -> lierb.Problem:
    return lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.free(), **more)


def refused(problem, message, names="twist0", **options):
    start = {"twist0": (0.0,) * 6} if isinstance(problem, lierb.Problem) else {}
    with pytest.raises(ArgumentError, match=message):
        lierb.integrate(problem, **(start | RUN | options), with_respect_to=names)


def test_functions_that_run_body_by_body_are_refused_by_name():
    @lierb.wrench
    def branching(t, R, r, omega, v):
        return (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0) if t > 0.5 else (0.0, 0.0, 0.0))

    with pytest.warns(lierb.errors.ScalarFunctionWarning):
        problem = free_body(forces=branching())
    refused(problem, "branching runs body by body, without derivatives")


def test_times_of_jumps_are_refused_by_name():
    refused(
        free_body(forces=burn()), "burn.stop.* determines times at which burn jumps", "burn.stop"
    )


def test_a_centre_of_mass_on_another_cspace_is_refused():
    refused(free_body(), 'body.com cannot change on cspace="SO3xR3"', "body.com", cspace="SO3xR3")


@pytest.mark.long
def test_runs_that_continue_are_refused_and_copies_of_their_poses_are_not():
    problem, _ = top()
    end = spun().end
    with pytest.raises(ArgumentError, match="the run that ended in"):
        lierb.integrate(problem, **end, dt=1e-2, t_end=0.2, with_respect_to="omega0")
    begun = end | {"pose0": end["pose0"].copy()}
    result = lierb.integrate(problem, **begun, dt=1e-2, t_end=0.2, **ROWS)
    assert np.isfinite(result.sensitivity("pose", "omega0")).all()


def test_observables_with_the_name_of_a_quantity_are_refused():
    @lierb.observable
    def pose(r):
        return r[0]

    refused(free_body(observables=pose()), "pose is a quantity of the run")


def test_results_without_derivatives_say_how_to_get_them():
    result = spun()
    assert result.sensitivities is None
    with pytest.raises(ArgumentError, match="integrate with with_respect_to="):
        result.sensitivity("pose", "omega0")


def test_quantities_that_are_not_differentiated_are_refused_with_those_that_are():
    result = spun(**ROWS)
    with pytest.raises(UnknownNameError, match="of='position' is unknown; choose from pose, twist"):
        result.sensitivity("position", "omega0")
    with pytest.raises(UnknownNameError, match="with_respect_to='twist0' is unknown"):
        result.sensitivity("pose", "twist0")
    with pytest.raises(UnknownNameError, match="of='t' is unknown"):
        result.sensitivity("t", "omega0")  # no event ends the run


def test_derivatives_larger_than_the_memory_are_refused():
    problem, twist = top()
    twists = np.broadcast_to(twist, (10**7, 6))
    with pytest.raises(lierb.errors.MemoryLimitError, match="take fewer parameters"):
        lierb.integrate(
            problem, twist0=twists, dt=1e-3, t_end=2e-3, with_respect_to=["pose0", "body.inertia"]
        )


# ---- tables ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_tables_have_the_rows_of_the_run_and_units():
    result = spun(**ROWS)
    tables = result.sensitivities
    assert tables.parameters == ("omega0", "gravity")
    assert tables.quantities == ("pose", "twist", "energy", "lambda", "reaction")
    assert tables.summary.num_rows == result.summary.num_rows == 1
    for name in ("trajectory", "step", "t"):
        assert tables.history[name].equals(result.history[name])
    field = tables.history.schema.field("lambda/omega0")
    assert field.metadata == {b"unit": b"N, N, N", b"per": b"rad/s", b"shape": b"3, 3"}
    assert tables.summary.schema.metadata == result.summary.schema.metadata
    for of, shape in (("pose", (6,)), ("energy", ()), ("lambda", (3,)), ("reaction", (6,))):
        assert result.sensitivity(of, "omega0").shape == (3, 1, *shape, 3)
    # the last row is the end
    last = np.array(tables.summary["reaction/omega0"].to_pylist()).reshape(1, 6, 3)
    assert np.array_equal(last, result.sensitivity("reaction", "omega0")[-1])


@pytest.mark.long
def test_a_mechanism_has_columns_of_links_and_joints():
    names = ["upper.body.mass"]
    result = swung(
        save_every=10, record=("state", "multipliers", "reaction"), with_respect_to=names
    )
    assert result.sensitivities.quantities == (
        "upper.pose", "upper.twist", "lower.pose", "lower.twist", "energy", "work",
        "upper.lambda", "lower.lambda", "upper.reaction", "lower.reaction",
    )  # fmt: skip
    assert result.sensitivity("lower.lambda", "upper.body.mass").shape == (2, 1, 5, 1)
    assert result.sensitivity("upper.reaction", "upper.body.mass").shape == (2, 1, 6, 1)
    # The upper joint bears the upper link: without gravity of it, its force changes by the mass.
    force = result.sensitivity("upper.reaction", "upper.body.mass")[0, 0, 3:, 0]
    assert np.abs(force).max() > 1.0


def test_a_batch_has_a_row_for_each_trajectory():
    problem, twist = top()
    result = lierb.integrate(problem, twist0=np.stack([twist, 0.5 * twist, -twist]), **RUN, **ROWS)
    assert result.sensitivities.summary.num_rows == 3
    assert result.sensitivity("pose", "omega0").shape == (3, 3, 6, 3)
    assert result.sensitivity("energy", "omega0").shape == (3, 3, 3)


def test_failed_trajectories_have_no_derivatives():
    problem, twist = top()
    twists = np.stack([twist, 1e8 * twist])
    with pytest.warns(lierb.errors.FailedTrajectoryWarning):
        result = lierb.integrate(problem, twist0=twists, **RUN, **ROWS)
    pose = result.sensitivity("pose", "omega0")
    assert np.isfinite(pose[:, 0]).all()
    assert np.isnan(pose[-1, 1]).all()
    summary = np.array(result.sensitivities.summary["pose/omega0"].to_pylist())
    assert np.isnan(summary[1]).all()


@pytest.mark.long
def test_results_with_derivatives_are_pickled_and_described():
    result = spun(with_respect_to=["omega0", "gravity"])
    again = pickle.loads(pickle.dumps(result))
    for name in ("omega0", "gravity"):
        assert np.array_equal(again.sensitivity("twist", name), result.sensitivity("twist", name))
    assert "derivatives  by omega0, gravity" in repr(result)


@pytest.mark.slow
def test_progress_is_that_of_all_runs_together():
    seen = []
    nine = {"with_respect_to": ("twist0", "gravity")}
    spun(**(ROWS | nine), progress=lambda *of: seen.append(of))
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert seen[-1] == (20, 20)  # ten steps for six directions, and ten for three


@pytest.mark.long
def test_warnings_of_a_start_point_to_the_callers_line():
    problem, twist = top()
    off = twist + np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.1))
    with pytest.warns(lierb.errors.InconsistentStateWarning) as issued:
        lierb.integrate(
            problem, twist0=off, **RUN, check="warn", solver="saddle", with_respect_to="body.mass"
        )
    assert issued[0].filename == __file__


def test_a_run_without_derivatives_lists_no_parameters(monkeypatch):
    """Those of a hundred links would take longer than the run."""
    from lierb.runs.parameters import chosen_parameters

    monkeypatch.setattr("lierb.runs.parameters.parameters_by_name", None)
    assert chosen_parameters(top()[0], ()) == ()
