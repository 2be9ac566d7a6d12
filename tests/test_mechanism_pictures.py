"""Moving pictures and figures of mechanisms: links, joints and loops of one view."""

from __future__ import annotations

import base64
import json
import pickle
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from mechanisms.shared import double_pendulum, four_bar

import lierb
from lierb.errors import ArgumentError, UnknownNameError

PLAYER = Path(lierb.animation.__file__).parent / "player.js"
NODE = shutil.which("node")
LINKS = ("crank", "coupler", "rocker")


def decoded(text: str, width: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(-1, width)


@pytest.fixture(scope="module")
def turning() -> lierb.Result:
    """A four-bar whose crank goes round, 41 saved times; its loop opens by 1e-8 m."""
    bar = four_bar()
    pose0 = bar.close(bar.pose({"crank": -1.0, "coupler": 0.5, "rocker": -1.6}))
    twist0 = bar.project(bar.twist({"crank": 20.0}, pose0), pose0)
    return lierb.integrate(
        bar, pose0=pose0, twist0=twist0, dt=1e-3, t_end=0.4, save_every=10, record="state"
    )


def end_of(result: lierb.Result, link: str, point) -> np.ndarray:
    """Where a point of a link is, (times, 3)."""
    return result[link].position[:, 0] + result[link].rotation[:, 0] @ np.asarray(point)


# ---- moving pictures ---------------------------------------------------------------------------


@pytest.mark.slow
def test_scene_has_links_and_joints_parents_first_and_loops_last(turning):
    (view,) = turning.animate().scene["views"]
    assert [body["name"] for body in view["bodies"]] == [*LINKS]
    joints = [(j["name"], j["parent"], j["child"], j["closes"]) for j in view["joints"]]
    assert joints == [
        ("crank", None, 0, False), ("rocker", None, 2, False), ("coupler", 0, 1, False),
        ("pin", 2, 1, True),
    ]  # fmt: skip
    for body, link in zip(view["bodies"], LINKS, strict=True):
        places = decoded(body["poses"], 7)[:, 4:]
        np.testing.assert_allclose(places, turning[link].position[:, 0], atol=1e-7)
    assert turning.animate().scene["title"] == "3 links and 1 loop, RK4, dt = 0.001 s"


def test_gap_of_a_loop_is_how_far_its_ends_are_apart(turning):
    (view,) = turning.animate().scene["views"]
    found = decoded(view["joints"][3]["gap"], 6)
    apart = end_of(turning, "coupler", (0.15, 0, 0)) - end_of(turning, "rocker", (0.125, 0, 0))
    assert np.abs(apart).max() > 1e-9
    # single precision of the gap; the ends themselves are rounded at 1e-16 m
    np.testing.assert_allclose(found[:, 3:], apart, rtol=1e-6, atol=1e-15)
    for joint in view["joints"][:3]:  # kept on the subgroups
        assert np.abs(decoded(joint["gap"], 6)).max() < 1e-14


def test_gap_of_links_is_what_the_child_is_moved_by():
    """Of poses that are off, as on SE(3)²: along the pin, and across it."""
    from lierb.results.animation.drawn_joints import gap_of

    pendulum = double_pendulum()
    poses = pendulum.pose({"upper": [0.3, 0.7], "lower": 0.4})
    apart = np.array([[0.0, 3e-8, 0.0], [1e-7, 0.0, -2e-7]])
    poses["lower"][:, :3, 3] += apart
    upper, lower = (gap_of(pendulum, at, list(poses.values())) for at in pendulum.joints)
    np.testing.assert_allclose(upper, 0.0, atol=1e-15)
    np.testing.assert_allclose(lower[:, 3:], apart, rtol=1e-8, atol=1e-15)
    np.testing.assert_allclose(lower[:, :3], 0.0, atol=1e-15)


def test_bones_lead_from_joint_to_joint(turning):
    (view,) = turning.animate().scene["views"]
    bones = {body["name"]: body["bones"] for body in view["bodies"]}
    assert bones == {
        "crank": [[[-0.05, 0, 0], [0.05, 0, 0]]],
        "coupler": [[[-0.15, 0, 0], [0.15, 0, 0]]],
        "rocker": [[[-0.125, 0, 0], [0.125, 0, 0]]],
    }


def test_shapes_and_trails_are_by_link(turning):
    ball = lierb.animation.box((0.1, 0.1, 0.1))
    scene = turning.animate(shape={"crank": ball}, trail={"rocker": (0.125, 0, 0)}).scene
    bodies = scene["views"][0]["bodies"]
    assert bodies[0]["shape"]["vertices"] == ball.vertices.tolist()
    assert [body["trail"] for body in bodies] == [None, None, [0.125, 0, 0]]
    # by default those that carry no other link
    bodies = turning.animate().scene["views"][0]["bodies"]
    assert [body["trail"] is not None for body in bodies] == [False, True, True]


def test_arguments_of_pictures_are_checked(turning):
    ball = lierb.animation.box((0.1, 0.1, 0.1))
    with pytest.raises(ArgumentError, match="expected a dictionary of shapes by link"):
        turning.animate(shape=ball)
    with pytest.raises(UnknownNameError, match="Did you mean 'rocker'"):
        turning.animate(shape={"rockr": ball})
    with pytest.raises(ArgumentError, match=r"trail=.*expected a flag, or a dictionary"):
        turning.animate(trail=(0, 0, 1))
    with pytest.raises(ArgumentError, match="give problem="):
        pickle.loads(pickle.dumps(turning)).animate()
    again = pickle.loads(pickle.dumps(turning)).animate(problem=four_bar())
    assert again.scene == turning.animate().scene
    stateless = lierb.Result(turning.summary, turning.history.select(["trajectory", "step", "t"]))
    with pytest.raises(ArgumentError, match='record="state"'):
        stateless.animate(problem=four_bar())


@pytest.mark.skipif(not NODE, reason="no node here")
def test_player_moves_children_with_what_they_hang_on():
    """A gap of the first joint carries the second body along; a loop moves none."""
    still, gap = [1.0, 0, 0, 0, 0, 0, 0], [0, 0, 0, 0.01, 0.0, 0.02]
    frames = {"parent_frame": np.eye(4).ravel().tolist(), "child_frame": np.eye(4).ravel().tolist()}
    none = [0.0] * 6
    joints = [
        {"parent": None, "child": 0, "closes": False, "gap": gap},
        {"parent": 0, "child": 1, "closes": False, "gap": none},
        {"parent": None, "child": 1, "closes": True, "gap": gap},
    ]
    view = {"bodies": [{"poses": still}] * 2, "joints": [frames | joint for joint in joints]}
    script = (
        f"const p=require({json.dumps(str(PLAYER))});"
        f"console.log(JSON.stringify(p.shown({json.dumps(view)},0,0,5)))"
    )
    done = subprocess.run([NODE, "-e", script], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    moved = 4 * np.array(gap[3:])  # four gaps are added
    for body in found["bodies"]:
        np.testing.assert_allclose(body["p"], moved, atol=1e-15)
    np.testing.assert_allclose(found["joints"][2]["point"], moved, atol=1e-15)
    np.testing.assert_allclose(found["joints"][2]["allowed"], moved - 5 * np.array(gap[3:]))


# ---- figures -----------------------------------------------------------------------------------


def titles(figure) -> list[str]:
    return [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()]


def test_angles_of_the_joints_count_their_turns(turning):
    figure = turning.plot("angles")
    assert titles(figure) == ["joint angles [rad]"]
    (axes,) = figure.axes
    drawn = {line.get_label(): line.get_ydata() for line in axes.lines if len(line.get_ydata())}
    angles = [line.get_ydata() for line in axes.lines if len(line.get_ydata()) > 1]
    assert len(drawn) == 3
    spun = turning["crank"].omega[:, 0, 1]
    by_rates = np.trapezoid(spun, turning.t)
    crank = angles[0]
    assert abs(crank[-1] - crank[0]) > np.pi  # further than an arc tangent goes
    np.testing.assert_allclose(crank[-1] - crank[0], by_rates, rtol=1e-2)  # the trapezoids' error


def test_panels_of_links_and_joints_are_drawn_when_asked_for(turning):
    assert "coupler: angular velocity [rad/s]" not in titles(turning.plot())
    figure = turning.plot(["coupler.omega", "pin.position_error"])
    assert titles(figure) == ["pin: position error [m]", "coupler: angular velocity [rad/s]"]
    with pytest.raises(UnknownNameError, match=r"pin\.position_error"):
        turning.plot("pin.positon_error")


def test_plot_of_a_pickled_mechanism_has_the_motion_of_its_links(turning):
    again = pickle.loads(pickle.dumps(turning))
    assert "rocker: position [m]" in titles(again.plot())
    assert titles(again.plot("angles", problem=four_bar())) == ["joint angles [rad]"]


def test_failed_trajectories_of_mechanisms_end(turning):
    """Of a history whose last states are lost, as after a failure."""
    from lierb.results.columns import as_array, vectors

    history = turning.history
    for number, field in enumerate(history.schema):
        if field.name.endswith((".rotation", ".position")):
            values = as_array(history[field.name]).copy()
            values[-5:] = np.nan
            history = history.set_column(number, field, vectors(values))
    lost = lierb.Result(turning.summary, history)
    (axes,) = lost.plot("angles", problem=four_bar()).axes
    assert np.isnan(axes.lines[0].get_ydata()[-5:]).all()
    poses = decoded(lost.animate(problem=four_bar()).scene["views"][0]["bodies"][0]["poses"], 7)
    assert np.isnan(poses[-5:]).all()
    assert np.isfinite(poses[:-5]).all()


def test_double_pendulum_of_many_trajectories_is_drawn_as_quantiles():
    pendulum = double_pendulum()
    pose0 = pendulum.pose({"upper": np.linspace(0.5, 1.0, 9)})
    result = lierb.integrate(
        pendulum, pose0=pose0, twist0=pendulum.twist({}, pose0), dt=1e-2, t_end=0.2, save_every=5,
        record="state",
    )  # fmt: skip
    assert len(result.animate().scene["views"]) == 8
    assert "9 trajectories" in result.plot("angles").get_supxlabel()
