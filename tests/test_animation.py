"""Moving pictures: what a scene says of a result, and that the page draws just that."""

from __future__ import annotations

import base64
import html
import json
import pickle
import re
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cases import integrate, joint, tilted, top

import lierb
from lierb.errors import ArgumentError, FailedTrajectoryWarning, StudyFileError
from lierb.results.animation import shapes
from lierb.results.animation.drawn_joints import gap_of
from lierb.results.animation.page import FRAMES, MOST_VIEWS
from lierb.results.colours import CSPACE_COLOURS

MOST_BYTES = 40_000  # of the page without its scene
PLAYER = Path(lierb.animation.__file__).parent / "player.js"
NODE, CHROMIUM = shutil.which("node"), shutil.which("chromium")


def decoded(text: str, width: int = 1, kind: str = "<f4") -> np.ndarray:
    numbers = np.frombuffer(base64.b64decode(text), kind)
    return numbers.reshape(-1, width) if width > 1 else numbers


@pytest.fixture(scope="module")
def spun() -> dict[str, lierb.Result]:
    """Two tops, in both c-spaces, 51 saved times."""
    problem, twist0 = top()
    twists = np.stack([twist0, 0.9 * twist0])
    return {
        cspace: integrate(
            problem, twist0=twists, cspace=cspace, solver="saddle", dt=1e-3, t_end=0.5,
            save_every=10,
        )
        for cspace in ("SE3", "SO3xR3")
    }  # fmt: skip


def test_save_overwrites_nothing_but_pages(spun, tmp_path):
    animation = lierb.animate(spun["SE3"])
    page, other = tmp_path / "top.html", tmp_path / "top.toml"
    other.write_text("name = 'top'")
    assert animation.save(page) == animation.save(page) == page
    assert page.read_text(encoding="utf-8") == animation.html()
    with pytest.raises(StudyFileError, match="is there and no HTML page"):
        animation.save(other)
    assert other.read_text() == "name = 'top'"


# ---- shapes ------------------------------------------------------------------------------------


def solid(shape: shapes.Shape) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, centre and ∫ x xᵀ of what its faces enclose, by tetrahedra from the origin."""
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for face in shape.faces:
        a = shape.vertices[face[0]]
        for i, j in pairwise(face[1:]):
            b, c = shape.vertices[i], shape.vertices[j]
            v = np.dot(a, np.cross(b, c)) / 6.0
            total = a + b + c
            volume += v
            first += v * total / 4.0
            parts = sum(np.outer(x, x) for x in (a, b, c))
            second += v * (np.outer(total, total) + parts) / 20.0
    return volume, first / volume, second


def inertia_of(shape: shapes.Shape, mass: float) -> np.ndarray:
    """About the origin, of a homogeneous solid of that mass."""
    volume, _, second = solid(shape)
    second *= mass / volume
    return np.trace(second) * np.eye(3) - second


def turned(xi=(0.3, -0.8, 0.5)) -> np.ndarray:
    return lierb.lie.so3.exp(xi)


@pytest.mark.parametrize("moments", [(2.0, 3.0, 4.0), (1.0, 4.9, 5.0), (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("com", [(0.0, 0.0, 0.0), (0.4, -0.2, 0.7)])
def test_equivalent_box_has_the_bodys_inertia(moments, com):
    turn, mass = turned(), 2.5
    about = turn @ np.diag(moments) @ turn.T
    shift = np.dot(com, com) * np.eye(3) - np.outer(com, com)
    body = lierb.Body(mass, about + mass * shift, com)
    shape = shapes.equivalent(body)
    assert len(shape.faces) == 6
    np.testing.assert_allclose(inertia_of(shape, mass), body.inertia, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(solid(shape)[1], com, atol=1e-12)


@pytest.mark.parametrize(("along", "across"), [(1.0, 3.0), (3.0, 1.6), (1.0, 0.51)])
def test_equivalent_cylinder_has_the_bodys_inertia(along, across):
    """Compare with its prism, whose mean square radius is (2 + cos 2π/n)/3 of the circle's."""
    turn, mass = turned(), 2.5
    body = lierb.Body(mass, turn @ np.diag((across, across, along)) @ turn.T)
    shape = shapes.equivalent(body)
    assert len(shape.faces) == shapes.SIDES + 2
    step = 2 * np.pi / shapes.SIDES
    prism = turn.T @ inertia_of(shape, mass) @ turn
    np.testing.assert_allclose(prism[2, 2], along * (2 + np.cos(step)) / 3, rtol=1e-12)
    np.testing.assert_allclose(np.diag(prism)[:2], across, rtol=0.02)
    radius, length = shapes.cylinder_of(mass, along, across)
    np.testing.assert_allclose(0.5 * mass * radius**2, along)
    np.testing.assert_allclose(mass * (3 * radius**2 + length**2) / 12, across)


def test_shapes_of_lierbs_solids_are_those_solids():
    found = shapes.equivalent(lierb.bodies.box((0.1, 0.2, 0.3), mass=2.0))
    np.testing.assert_allclose(np.ptp(found.vertices, axis=0), (0.1, 0.2, 0.3))
    found = shapes.equivalent(lierb.bodies.cylinder(0.2, 0.7, mass=2.0))
    np.testing.assert_allclose(np.ptp(found.vertices, axis=0), (0.4, 0.4, 0.7))


def test_bodies_without_extent_are_drawn_thin():
    """A plate's three moments and a disc's are of no height, a rod's of no width."""
    plate = shapes.equivalent(lierb.Body(3.0, (1.0, 4.0, 5.0)))
    edges = np.ptp(plate.vertices, axis=0)
    np.testing.assert_allclose(edges, (4.0, 2.0, 4.0 * shapes.THINNEST))
    disc = shapes.equivalent(lierb.Body(2.0, (1.0, 1.0, 2.0)))
    np.testing.assert_allclose(np.ptp(disc.vertices, axis=0)[2], shapes.THINNEST * 2 * np.sqrt(2))
    rod = shapes.equivalent(lierb.Body(12.0, (1.0, 1.0, 1e-12)))
    np.testing.assert_allclose(np.ptp(rod.vertices, axis=0), (0.02, 0.02, 1.0), rtol=1e-6)


@pytest.mark.parametrize("shape", [shapes.box((1.0, 2.0, 3.0)), shapes.cylinder(1.0, 2.0)])
def test_faces_look_outward(shape):
    for face in shape.faces:
        a, b, c = shape.vertices[list(face[:3])]
        assert np.cross(b - a, c - b) @ a > 0.0


def test_placed_and_mesh_move_and_check():
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned(), (1.0, 2.0, 3.0)
    given = shapes.box((1.0, 1.0, 1.0))
    moved = given.placed(pose)
    np.testing.assert_allclose(moved.vertices, given.vertices @ turned().T + pose[:3, 3])
    assert shapes.mesh(given.vertices, given.faces).faces == given.faces
    with pytest.raises(ArgumentError, match="three or more of the indices 0 … 7"):
        shapes.mesh(given.vertices, [(0, 1, 8)])
    with pytest.raises(ArgumentError, match=r"vertices has shape \(8, 2\)"):
        shapes.mesh(given.vertices[:, :2], given.faces)
    with pytest.raises(ArgumentError, match="positive length"):
        shapes.box((1.0, 0.0, 1.0))


# ---- gaps --------------------------------------------------------------------------------------

OFF = 1e-5  # m and rad: the gap is of first order


@pytest.mark.parametrize("name", sorted(lierb.joints.JOINTS.keys() - {"free"}))
def test_gap_taken_back_closes_the_joint(name):
    """The body, moved back by the gap about the joint's point, is closed to second order."""
    problem, _ = tilted(name)
    off = lierb.lie.se3.exp(OFF * np.random.default_rng(3).normal(size=(5, 6)))
    poses = problem.joint.closed_pose @ off
    gap = gap_of(problem, problem.joints[0], [poses])
    point = problem.joint.body_frame[:3, 3]
    back = np.zeros_like(poses)
    back[:, 3, 3] = 1.0
    back[:, :3, :3] = lierb.lie.so3.exp(-gap[:, :3]) @ poses[:, :3, :3]
    arms = poses[:, :3, :3] @ point, back[:, :3, :3] @ point
    back[:, :3, 3] = poses[:, :3, 3] + arms[0] - gap[:, 3:] - arms[1]
    left = gap_of(problem, problem.joints[0], [back])
    assert np.abs(left).max() <= 100 * OFF**2
    assert np.abs(gap).max() <= 5 * OFF  # the shortest one
    assert np.abs(gap).max() > 0.01 * OFF


def test_gap_of_a_ball_joint_is_how_far_its_points_are_apart(spun):
    problem, _ = top()
    result = spun["SO3xR3"]
    place, turn = result.position[:, 0], result.rotation[:, 0]
    poses = np.zeros((len(place), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = turn, place, 1.0
    apart = place + turn @ problem.joint.body_frame[:3, 3] - problem.joint.ground_frame[:3, 3]
    gap = gap_of(problem, problem.joints[0], [poses])
    np.testing.assert_allclose(gap[:, 3:], apart, rtol=1e-9, atol=1e-15)
    column = result.history["position_error"].to_numpy().reshape(-1, 2)[:, 0]
    np.testing.assert_allclose(np.linalg.norm(gap[:, 3:], axis=1), column, rtol=1e-9, atol=1e-15)


# ---- the scene ---------------------------------------------------------------------------------


def test_cspaces_have_their_colours_and_trajectories_dashes(spun):
    """Views in any order, coloured as in figures."""
    for order in (spun, dict(reversed(spun.items()))):
        views = lierb.animate(order).scene["views"]
        found = {(view["title"], view["colour"], view["dash"]) for view in views}
        assert found == {
            (f"{space}, trajectory {number}", CSPACE_COLOURS[space], number)
            for number in (0, 1) for space in spun
        }  # fmt: skip
    alone = spun["SO3xR3"].animate().scene["views"]
    assert alone[0]["colour"] == CSPACE_COLOURS["SO3xR3"]
    assert alone[1]["colour"] not in (CSPACE_COLOURS["SE3"], CSPACE_COLOURS["SO3xR3"])
    assert [view["dash"] for view in alone] == [0, 0]


def test_scene_has_the_results_poses_in_single_precision(spun):
    scene = lierb.animate(spun).scene
    titles = [f"{space}, trajectory {number}" for number in (0, 1) for space in ("SE3", "SO3xR3")]
    assert [view["title"] for view in scene["views"]] == titles
    for view, (result, number) in zip(
        scene["views"], [(result, number) for number in (0, 1) for result in spun.values()]
    ):
        (body,) = view["bodies"]
        poses = decoded(body["poses"], 7)
        np.testing.assert_array_equal(poses[:, :4], result.quaternion[:, number].astype("f4"))
        np.testing.assert_array_equal(poses[:, 4:], result.position[:, number].astype("f4"))
        np.testing.assert_array_equal(decoded(view["t"], kind="<f8"), result.t)
        column = result.history["position_error"].to_numpy().reshape(-1, 2)[:, number]
        np.testing.assert_array_equal(
            decoded(view["values"]["position_error"]), column.astype("f4")
        )
    assert scene["curves"] == {"position_error": "position error [m]"}
    assert scene["up"] == [0.0, 0.0, 1.0]


def test_magnified_the_largest_gap_is_seen(spun):
    both, exact = (lierb.animate(r).scene["magnify"] for r in (spun, spun["SE3"]))
    largest = spun["SO3xR3"].summary["position_error_max"].to_numpy().max()
    assert 0.1 < both * largest < 10.0  # m, at bodies of a metre
    assert exact == 1.0  # there is nothing but rounding


def test_magnify_is_where_the_slider_begins(spun):
    """And it reaches that far."""
    asked = {factor: lierb.animate(spun["SE3"], magnify=factor).scene for factor in (1, 1e4)}
    assert {f: (s["magnified"], s["magnify"]) for f, s in asked.items()} == {
        1: (1.0, 1.0), 1e4: (1e4, 1e4),
    }  # fmt: skip


def test_magnified_bodies_stay_in_view(spun):
    """A gap of the bodies' size, in the view of the motion, is the most that is shown."""
    asked = lierb.animate(spun["SO3xR3"], magnify=1e12).scene
    largest = spun["SO3xR3"].summary["position_error_max"].to_numpy().max()
    assert asked["magnified"] == asked["magnify"] < 1e12
    assert 0.1 * asked["size"] < largest * asked["magnified"] < 0.5 * asked["size"]
    assert any("instead of 1e+12" in note for note in asked["notes"])
    assert not lierb.animate(spun["SO3xR3"], magnify=10.0).scene["notes"]


@pytest.mark.slow
def test_gaps_of_joints_that_are_exact_are_zero():
    """As the curves of their errors are: the poses are rounded."""
    rod, axis = lierb.bodies.box((0.1, 0.1, 1.0), mass=1.0), (0.3, 1.0, 0.2)
    hinges = (
        lierb.joints.revolute((0.0, 0.1, 0.5), axis=axis, ground_point=(0.3, 0.4, 1.0)),
        lierb.joints.revolute((0.0, 0.0, 0.5), axis=axis, parent_point=(0.1, 0.0, -0.5)),
    )
    links = lierb.Link("a", rod, hinges[0]), lierb.Link("b", rod, hinges[1], "a")
    chain, saved = lierb.Mechanism(links), {"dt": 0.01, "t_end": 0.5, "save_every": 5}
    start = {"twist0": chain.twist({"a": 3.0, "b": -5.0})}
    for cspace, is_exact in (("reduced", True), ("SE3", False)):
        run = {**start, **saved, "record": "state", "cspace": cspace}
        (view,) = lierb.integrate(chain, **run).animate().scene["views"]
        gaps = np.hstack([decoded(each["gap"]) for each in view["joints"]])
        assert np.any(decoded(view["values"]["position_error"])) != is_exact
        assert np.any(gaps) != is_exact


def test_long_histories_are_thinned_and_keep_their_largest_errors(spun):
    result = spun["SO3xR3"]
    assert len(result.t) < FRAMES
    view = result.animate(trajectories=1, frames=7).scene["views"][0]
    t, errors = decoded(view["t"], kind="<f8"), decoded(view["values"]["position_error"])
    assert len(t) == 7
    assert (t[0], t[-1]) == (0.0, 0.5)
    column = result.history["position_error"].to_numpy().reshape(-1, 2)[:, 1]
    assert errors.max() == np.float32(column.max())
    rows = np.rint(t / 0.01).astype(int)  # of the 51 that were saved
    since = zip([-1, *rows[:-1]], rows)
    expected = [column[a + 1 : b + 1].max() for a, b in since]
    np.testing.assert_array_equal(errors, np.array(expected, "f4"))


def test_saved_too_rarely_it_says_so(spun):
    scene = spun["SE3"].animate(trajectories=0, frames=5).scene
    assert "save more often" in scene["notes"][0]
    assert spun["SE3"].animate(trajectories=0).scene["notes"] == []  # 1.5 rad is seen


def test_of_many_trajectories_the_first_are_shown_and_counted():
    body = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    flight = lierb.Problem(body, lierb.joints.free())
    twists = np.tile((0.0, 0.0, 1.0, 9.0, 0.0, 0.0), (20, 1))
    result = integrate(flight, twist0=twists, dt=0.1, t_end=1.0, save_every=1)
    scene = result.animate().scene
    assert len(scene["views"]) == MOST_VIEWS
    assert f"The first {MOST_VIEWS} of 20" in scene["notes"][0]
    assert scene["follow"]  # 9 m away: the camera goes with it
    assert scene["curves"] == {"energy_drift": "energy drift [J]"}  # there is no joint to drift
    assert scene["views"][0]["joints"] == []


@pytest.mark.parametrize("name", sorted(lierb.joints.JOINTS))
def test_axes_of_every_joint_are_those_it_turns_about_or_slides_along(name):
    from lierb.results.animation.drawn_joints import _axes, _slides

    turns = {
        "revolute": ([2], [2]), "cylindrical": ([2], [2]), "screw": ([2], [2]),
        "planar": ([2], [2]), "helical_planar": ([2], [2]), "schoenflies": ([2], [2]),
        "pin_in_slot": ([2], [2]), "pin_in_slot_body": ([2], [2]), "universal": ([2], [1]),
        "hook": ([1], [2]), "constant_velocity": ([2], [2]),
    }  # fmt: skip
    slides = {
        "cylindrical": ([2], []), "prismatic": ([2], []), "screw": ([2], []),
        "pin_in_slot": ([0], []), "pin_in_slot_body": ([], [0]), "point_on_line": ([2], []),
    }  # fmt: skip
    assert _axes(joint(name)) == turns.get(name, ([], []))
    assert _slides(joint(name)) == slides.get(name, ([], []))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lierb.errors.StiffStepWarning")
def test_what_failed_ends_as_nan_and_is_named():
    body = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    spring = lierb.forces.spring_damper(body_point=(0.05, 0.0, 0.0), stiffness=1e9)
    problem = lierb.Problem(body, lierb.joints.free(), forces=[spring])
    with pytest.warns(FailedTrajectoryWarning):
        result = integrate(problem, twist0=(0.0, 0.0, 1.0, 1.0, 0.0, 0.0), dt=0.1, t_end=5.0,
                           save_every=1)  # fmt: skip
    (view,) = result.animate().scene["views"]
    assert view["title"].startswith("non_finite at ")
    poses = decoded(view["bodies"][0]["poses"], 7)
    assert np.isfinite(poses[0]).all()
    assert np.isnan(poses[-1]).all()
    json.dumps(result.animate().scene, allow_nan=False)


def test_a_body_that_runs_away_leaves_a_page_that_can_be_read():
    """Up to 1e100 m, which single precision has no number for, and JSON none for infinity."""
    body = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    flight = lierb.Problem(body, lierb.joints.free())
    result = integrate(flight, twist0=(0.0, 0.0, 0.0, 1e100, 0.0, 0.0), dt=0.1, t_end=1.0,
                       save_every=1)  # fmt: skip
    scene = result.animate().scene
    json.dumps(scene, allow_nan=False)
    assert np.isinf(decoded(scene["views"][0]["bodies"][0]["poses"], 7)[-1, 4])


def test_what_failed_before_it_moved_leaves_a_page():
    body = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    flight = lierb.Problem(body, lierb.joints.free())
    with pytest.warns(FailedTrajectoryWarning):
        result = integrate(flight, twist0=(0.0, 0.0, 0.0, 1e200, 0.0, 0.0), dt=0.1, t_end=1.0,
                           save_every=1)  # fmt: skip
    assert np.isnan(result.position).all()
    scene = result.animate().scene
    json.dumps(scene, allow_nan=False)
    assert scene["radius"] == pytest.approx(0.5 * np.hypot(0.1, np.hypot(0.2, 0.3)))


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e7])
def test_shapes_of_any_size_have_nine_digits(scale):
    """A box of 1 nm was rounded to nothing."""
    body = lierb.bodies.box((scale, 2 * scale, 3 * scale), mass=1.0)
    flight = lierb.Problem(body, lierb.joints.free())
    result = integrate(flight, twist0=(0.0, 0.0, 1.0, scale, 0.0, 0.0), dt=0.1, t_end=1.0,
                       save_every=1)  # fmt: skip
    shape = result.animate().scene["views"][0]["bodies"][0]["shape"]
    edges = np.ptp(shape["vertices"], axis=0)
    np.testing.assert_allclose(edges, (scale, 2 * scale, 3 * scale), rtol=1e-8)


def test_times_long_after_zero_are_told_apart():
    """Single precision has one number for all of 1e6 … 1e6 + 0.03 s."""
    body = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    flight = lierb.Problem(body, lierb.joints.free())
    result = integrate(flight, twist0=(0.0, 0.0, 1.0, 1.0, 0.0, 0.0), dt=1e-3, t0=1e6,
                       t_end=1e6 + 0.01, save_every=1)  # fmt: skip
    (view,) = result.animate().scene["views"]
    np.testing.assert_array_equal(decoded(view["t"], kind="<f8"), result.t)


# ---- what is refused ---------------------------------------------------------------------------


def test_results_without_states_are_refused_with_what_to_record(spun):
    problem, twist0 = top()
    for saved in ({}, {"save_every": 5, "record": ("multipliers", "reaction")}):
        result = lierb.integrate(problem, twist0=twist0, dt=1e-3, t_end=5e-3, **saved)
        with pytest.raises(ArgumentError, match='save_every=… or save_at=…, and record="state"'):
            result.animate()


def test_arguments_are_checked(spun):
    result = spun["SE3"]
    for wrong, told in (
        ({"trajectories": 2}, "expected 0 … 1"), ({"trajectories": []}, "empty"),
        ({"frames": 1}, "at least 2"), ({"trail": (1.0, 2.0)}, r"expected \(3,\)"),
        ({"magnify": 0.5}, "a number, 1 …"), ({"magnify": "10"}, "a number, 1 …"),
    ):  # fmt: skip
        with pytest.raises(ArgumentError, match=told):
            result.animate(**wrong)
    with pytest.raises(ArgumentError, match=r"lierb\.integrate returned"):
        lierb.animate([1, 2])
    with pytest.raises(ArgumentError, match="empty"):
        lierb.animate({})


def test_a_pickled_result_needs_its_problem(spun):
    problem, _ = top()
    again = pickle.loads(pickle.dumps(spun["SE3"]))
    with pytest.raises(ArgumentError, match=r"lost its problem.*give problem="):
        again.animate()
    assert again.animate(problem=problem).scene == spun["SE3"].animate().scene


# ---- the page ----------------------------------------------------------------------------------


def test_page_is_small_and_needs_no_network(spun, tmp_path):
    animation = spun["SE3"].animate(tmp_path / "top.html", title="</script>\"%PLAYER%'<b>")
    page = (tmp_path / "top.html").read_text(encoding="utf-8")
    assert page == animation.html()
    before, rest = page.split('<script id="scene" type="application/json">')
    scene, after = rest.split("</script>", 1)
    assert json.loads(scene) == json.loads(json.dumps(animation.scene))
    own = before + after
    assert len(own.encode()) <= MOST_BYTES
    assert not re.search(r"https?:|//[a-z]+\.|\b(src|href|srcset)=|@import|url\(", own)
    assert not re.search(r"\b(import|fetch|XMLHttpRequest|WebSocket|EventSource|sendBeacon)\b", own)
    assert "default-src 'none'" in before  # and the browser sees to it
    assert html.escape("</script>\"%PLAYER%'<b>") in before


def test_notebooks_show_the_page_in_a_frame(spun):
    animation = spun["SE3"].animate()
    shown = animation._repr_html_()
    (inner,) = re.findall(r'srcdoc="([^"]*)"', shown)
    assert html.unescape(inner) == animation.html()
    assert 'sandbox="allow-scripts"' in shown


@pytest.mark.skipif(not NODE, reason="no node here")
def test_player_computes_as_python_does():
    """Rotations, poses between saved times, and where a body is with its gap magnified."""
    rng = np.random.default_rng(5)
    xi, gap = rng.normal(size=3), np.r_[rng.normal(size=3) * 1e-2, rng.normal(size=3) * 1e-2]
    quaternions = rng.normal(size=(2, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    places = rng.normal(size=(2, 3))
    frame = np.eye(4)
    frame[:3, 3] = (0.3, -0.2, 0.1)
    poses = np.hstack([quaternions, places]).ravel().tolist()
    given = {
        "xi": xi.tolist(), "times": [0.0, 1.0, 3.0], "poses": poses,
        "view": {
            "bodies": [{"poses": poses}],
            "joints": [{"parent": None, "child": 0, "child_frame": frame.ravel().tolist(),
                        "gap": np.tile(gap, 2).tolist()}],
        },
    }  # fmt: skip
    script = (
        f"const p=require({json.dumps(str(PLAYER))}),g={json.dumps(given)};"
        "console.log(JSON.stringify({r:p.rotation(g.xi),m:[-1,0,0.5,1,2,3,9].map(t=>p.moment(g.times,t)),"
        "a:p.poseAt(g.poses,0,0.25),s:p.shown(g.view,1,0,8),n:[1,3,7.2,0.02].map(p.nice)}))"
    )
    done = subprocess.run([NODE, "-e", script], capture_output=True, text=True, check=True)
    answer = json.loads(done.stdout)
    np.testing.assert_allclose(np.reshape(answer["r"], (3, 3)), turned(xi), atol=1e-15)
    assert answer["m"] == [[0, 0], [0, 0], [0, 0.5], [1, 0], [1, 0.5], [2, 0], [2, 0]]
    assert answer["n"] == [1, 2, 5, 0.02]
    np.testing.assert_allclose(answer["a"]["p"], 0.75 * places[0] + 0.25 * places[1])
    sign = np.sign(quaternions[0] @ quaternions[1])
    between = 0.75 * quaternions[0] + 0.25 * sign * quaternions[1]
    np.testing.assert_allclose(np.reshape(answer["a"]["m"], (3, 3)), matrix_of(between), atol=1e-15)
    (body,), (held,) = answer["s"]["bodies"], answer["s"]["joints"]
    rotation = turned(7 * gap[:3]) @ matrix_of(quaternions[1])  # seven gaps are added
    point = matrix_of(quaternions[1]) @ frame[:3, 3] + places[1]
    np.testing.assert_allclose(np.reshape(body["m"], (3, 3)), rotation, atol=1e-14)
    np.testing.assert_allclose(held["point"], point + 7 * gap[3:], atol=1e-14)
    np.testing.assert_allclose(held["allowed"], point - gap[3:], atol=1e-14)
    np.testing.assert_allclose(body["p"] + rotation @ frame[:3, 3], held["point"], atol=1e-14)


# A page without a browser: what the player draws is recorded, [canvas, colour, points].
STUB = """
const drawn = [], texts = [];
const pen = (name) => { let p = []; return {
  beginPath() { p = []; }, moveTo(x, y) { p.push([x, y]); }, lineTo(x, y) { p.push([x, y]); },
  stroke() { drawn.push([name, this.strokeStyle, p]); }, fillText(t) { texts.push([name, t]); },
  measureText: () => ({ width: 20 }), ...Object.fromEntries(["fill", "arc", "closePath",
  "setLineDash", "setTransform", "clearRect", "strokeText", "drawImage", "save", "restore", "rect",
  "clip", "fillRect"].map((x) => [x, () => 0])) }; };
const element = (name, w = 0, h = 0) => ({ clientWidth: w, clientHeight: h, width: 0, height: 0,
  style: { setProperty() {} }, getContext: () => pen(name), addEventListener() {}, append() {} });
const elements = {};
global.document = { documentElement: {}, addEventListener() {},
  querySelector: (name) => element(name, 800, name.includes("stage") ? 600 : 120),
  getElementById: (id) => (id === "scene" ? { textContent: scene } : elements[id] ??= element(id)),
  createElement: () => element("curves") };
global.window = { matchMedia: () => ({ matches: true }) };
window.parent = window;
global.ResizeObserver = class { observe() {} };
let frames = 0;
global.requestAnimationFrame = (draw) => { if (!frames++) draw(0); };
"""


@lierb.observable(unit="m")
def height(r):
    return r[2]


@pytest.mark.skipif(not NODE, reason="no node here")
def test_strips_have_room_for_their_titles():
    calls = [(count, width) for count in range(1, 7) for width in range(280, 1300, 60)]
    script = (
        f"const {{ strips }} = require({json.dumps(str(PLAYER))});"
        f"console.log(JSON.stringify({json.dumps(calls)}.map(([n, w]) => strips(n, w, 100))))"
    )
    done = subprocess.run([NODE, "-e", script], capture_output=True, text=True, check=True)
    for (count, width), found in zip(calls, json.loads(done.stdout), strict=True):
        corners = [(box["x"] - 44, box["y"] - 20) for box in found["boxes"]]
        across = width / max(sum(y == corners[0][1] for _, y in corners), 1)
        assert len({*corners}) == count
        assert across >= 125  # "position error [m]" takes 105
        assert found["rows"] == -(-count // (width // 125))
        for x, y in corners:
            assert 0 <= x <= width - across + 1e-9
            assert 0 <= y <= 100 - 100 / found["rows"] + 1e-9


@pytest.mark.slow
@pytest.mark.skipif(not NODE, reason="no node here")
def test_ground_axes_are_seen_when_the_camera_follows():
    body = lierb.bodies.box((0.3, 0.1, 0.05), mass=1.0)
    flight = lierb.Problem(body, lierb.joints.free(), gravity=(0.0, 0.0, -9.81))
    run = {"twist0": (1.0, 2.0, 3.0, 10.0, 0.0, 20.0), "dt": 0.01, "t_end": 4.0, "save_every": 4}
    scene = lierb.integrate(flight, **run, record="state").animate().scene
    assert scene["follow"]
    script = (
        f"const scene = {json.dumps(json.dumps(scene))};{STUB}"
        f"require({json.dumps(str(PLAYER))});"
        "const at = (t) => { drawn.length = 0; window.lierb.seek(t); window.lierb.draw();"
        "  return drawn.filter(([name, colour]) => colour === '#888').map(([, , p]) => p); };"
        "console.log(JSON.stringify([at(0), at(2), at(4)]))"
    )
    done = subprocess.run([NODE, "-e", script], capture_output=True, text=True, check=True)
    for lines in json.loads(done.stdout):
        points = np.array(lines)
        assert points.shape == (3, 2, 2)  # e₁, e₂, e₃
        assert np.all((points > 0.0) & (points < (800.0, 600.0)))
        assert np.linalg.norm(points[2, 1] - points[2, 0]) > 15.0  # up, in pixels


@pytest.mark.slow
@pytest.mark.skipif(not NODE, reason="no node here")
def test_player_draws_observables_and_the_axes_of_bodies():
    body = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    flight = lierb.Problem(body, lierb.joints.free(), gravity=(0.0, 0.0, -9.81))
    result = lierb.integrate(
        flight.with_(observables=height()), twist0=(1.0, 0.0, 2.0, 0.5, 0.0, 3.0), dt=1e-2,
        t_end=0.5, save_every=5, record="state",
    )  # fmt: skip
    scene = result.animate(targets={"goal": (0.0, 0.0, 9.0)}).scene
    assert scene["curves"]["height"] == "height [m]"
    script = (
        f"const scene = {json.dumps(json.dumps(scene))};{STUB}"
        f"require({json.dumps(str(PLAYER))});"
        "console.log(JSON.stringify({ drawn, texts }))"
    )
    done = subprocess.run([NODE, "-e", script], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    (curve,) = [p for name, _, p in found["drawn"] if name == "curves" and len(p) == 11][-1:]
    heights = result.history["height"].to_numpy()
    x, y = np.array(curve).T
    np.testing.assert_allclose(np.diff(x), np.diff(x)[0])  # equidistant times
    slope = np.diff(y) / np.diff(heights)
    np.testing.assert_allclose(slope, slope[0], rtol=1e-5)  # linear, in float32
    assert slope[0] < 0.0  # a canvas counts downwards
    assert ["curves", "height [m]"] in found["texts"]
    colours = [colour for name, colour, _ in found["drawn"] if name.startswith("#stage")]
    assert {"#c33", "#393", "#33c"} <= {*colours}
    assert "goal" in {text for name, text in found["texts"] if name.startswith("#stage")}
    assert colours.count("#a0178c") >= 3  # the arms of the cross


def test_targets_are_points_paths_and_poses_and_stay_in_view(spun):
    pose = np.eye(4)
    pose[:3, 1:3] = -pose[:3, 1:3]
    pose[:3, 3] = (0.0, 0.0, 5.0)
    path = [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (1.0, 2.0, 1.0)]
    targets = {"point": (3.0, 0.0, 0.0), "path": path, "pose": pose}
    scene = lierb.animate(spun["SE3"], targets=targets).scene
    point, line, frame = scene["targets"]
    assert point == {"name": "point", "points": [[3.0, 0.0, 0.0]], "axes": None}
    assert line["points"] == [list(p) for p in path]
    assert frame["points"] == [[0.0, 0.0, 5.0]]
    assert frame["axes"] == pose[:3, :3].tolist()
    for each in np.vstack([t["points"] for t in scene["targets"]]):
        assert np.linalg.norm(each - scene["centre"]) <= scene["radius"] + 1e-12
    (alone,) = lierb.animate(spun["SE3"], targets=path).scene["targets"]
    assert alone["name"] == ""


def test_a_far_target_leaves_the_motion_in_sight(spun):
    alone = lierb.animate(spun["SE3"]).scene
    far = lierb.animate(spun["SE3"], targets={"far": (0.0, 1000.0, 0.0)}).scene
    assert (far["radius"], far["centre"]) == (alone["radius"], alone["centre"])
    assert far["notes"] == ["Far from the motion, and out of sight: far."]
    assert far["targets"][0]["points"] == [[0.0, 1000.0, 0.0]]


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ((1.0, 2.0), r"targets has shape \(2,\); expected \(3,\), \(k, 3\) of a path or \(4, 4\)$"),
        (np.zeros((0, 3)), r"targets has shape \(0, 3\); expected \(3,\), \(k, 3\) of a path"),
        (np.zeros((2, 2, 3)), r"targets has shape \(2, 2, 3\); expected \(3,\)"),
        ({"goal": np.zeros((2, 4, 4))}, r"targets\['goal'\] has shape \(2, 4, 4\)"),
        ({"goal": np.ones((4, 4))}, r"targets\['goal'\]"),
        ((np.nan, 0.0, 0.0), r"targets\[0\] is nan"),
    ],
)
def test_targets_are_checked(spun, targets, message):
    with pytest.raises(ValueError, match=message):
        lierb.animate(spun["SE3"], targets=targets)


def matrix_of(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q / np.linalg.norm(q)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


SEEK = """<script>{
const L = window.lierb, canvas = document.querySelector("#stage canvas"), found = [];
L.play(false); L.magnify(FACTOR); L.orbit(0.4, 0.3);
for (const t of TIMES) {
  L.seek(t); L.draw();
  const { data, width } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let n = 0, x = 0, y = 0;
  for (let i = 0; i < data.length; i += 4)
    if (data[i + 3] > 200 && data[i + 2] > data[i] + 40) {
      n++; x += (i / 4) % width + 0.5; y += Math.floor(i / 4 / width) + 0.5;
    }
  found.push([n, x / n, y / n]);
}
const { yaw, pitch, distance } = L.camera();
document.title = JSON.stringify({ found, yaw, pitch, distance, w: canvas.width, h: canvas.height });
}</script>"""


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM, reason="no Chromium here")
@pytest.mark.parametrize("factor", [1.0, 20.0])
def test_a_marker_is_drawn_where_the_pose_says_to_a_pixel(spun, tmp_path, factor):
    """A blue cube at the top's centre of mass; and the camera written down once more."""
    problem, _ = top()
    result, edge = spun["SO3xR3"], 0.25
    animation = result.animate(trajectories=0, shape=shapes.box((edge,) * 3), trail=False, title="")
    assert not animation.scene["follow"]
    rows = [0, 7, 23, 50]
    script = SEEK.replace("TIMES", str(result.t[rows].tolist())).replace("FACTOR", str(factor))
    page = tmp_path / "page.html"
    views = animation.scene["views"]
    views[0] |= {"title": "", "colour": "#0072B2"}  # not the gap's red; a swatch were as blue
    page.write_text(animation.html() + script, encoding="utf-8")
    shown = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
         "--disable-background-networking", "--host-resolver-rules=MAP * ~NOTFOUND",
         f"--user-data-dir={tmp_path / 'profile'}", "--window-size=900,700",
         "--virtual-time-budget=3000", "--dump-dom", page.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    ).stdout  # fmt: skip
    seen = json.loads(html.unescape(re.search("<title>(.*?)</title>", shown)[1]))
    turn, place = result.rotation[rows, 0], result.position[rows, 0]
    pin = problem.joint.body_frame[:3, 3]
    gap = place + turn @ pin - problem.joint.ground_frame[:3, 3]
    expected = place + (factor - 1.0) * gap
    yaw, pitch = seen["yaw"], seen["pitch"]
    back = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    right = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    offset = expected - animation.scene["centre"]
    focal = 0.5 * min(seen["w"], seen["h"]) / np.tan(np.radians(15.0))
    scale = focal / (seen["distance"] - offset @ back)
    x = seen["w"] / 2 + scale * (offset @ right)
    y = seen["h"] / 2 - scale * (offset @ np.cross(back, right))
    assert all(n > 100 for n, _, _ in seen["found"])
    np.testing.assert_allclose([p[1] for p in seen["found"]], x, atol=1.0)
    np.testing.assert_allclose([p[2] for p in seen["found"]], y, atol=1.0)
    assert np.ptp(x) > 20.0  # it moves
