"""Solids: against integrals over the volume, and a mesh against the solid that it encloses."""

import numpy as np
import pytest
from cases import integrate

import lierb
from lierb.errors import ArgumentError, MissingExtraError

MASS, DENSITY = 3.7, 850.0
SIZE, RADIUS, LENGTH = (0.3, 0.7, 0.2), 0.4, 1.3

# Where a solid is, on points (x, y, z) of the cuboid of half the given edges around it.
SOLIDS = {
    "box": (lambda **by: lierb.bodies.box(SIZE, **by), SIZE, lambda x, y, z: x == x),
    "cylinder": (
        lambda **by: lierb.bodies.cylinder(RADIUS, LENGTH, **by),
        (2 * RADIUS, 2 * RADIUS, LENGTH),
        lambda x, y, z: x * x + y * y <= RADIUS**2,
    ),
    "sphere": (
        lambda **by: lierb.bodies.sphere(RADIUS, **by),
        (2 * RADIUS,) * 3,
        lambda x, y, z: x * x + y * y + z * z <= RADIUS**2,
    ),
}
CELLS = 160  # along each edge; the surface's cells leave an error of about 1/CELLS²


@pytest.mark.parametrize(("make", "edges", "inside"), SOLIDS.values(), ids=SOLIDS)
def test_mass_and_inertia_are_the_integrals_over_the_volume(make, edges, inside):
    steps = [(np.arange(CELLS) + 0.5) / CELLS - 0.5] * 3
    x, y, z = (e * g for e, g in zip(edges, np.meshgrid(*steps, indexing="ij"), strict=True))
    share = np.where(inside(x, y, z), np.prod(edges) / CELLS**3, 0.0)
    squares = np.array([(share * s * s).sum() for s in (x, y, z)])
    body = make(density=DENSITY)
    assert body.mass == pytest.approx(DENSITY * share.sum(), rel=2e-3)
    expected = DENSITY * (squares.sum() - squares)
    np.testing.assert_allclose(np.diag(body.inertia), expected, rtol=3e-3)
    np.testing.assert_array_equal(body.inertia - np.diag(np.diag(body.inertia)), 0.0)
    np.testing.assert_array_equal(body.com, 0.0)


@pytest.mark.parametrize("make", [solid[0] for solid in SOLIDS.values()], ids=SOLIDS)
def test_mass_and_density_say_the_same(make):
    by_mass = make(mass=MASS)
    by_density = make(density=MASS / (make(density=1.0).mass))
    np.testing.assert_allclose(by_density.mass, MASS, rtol=4e-16)  # two roundings
    np.testing.assert_allclose(by_density.inertia, by_mass.inertia, rtol=1e-15)


def test_box_of_the_paper():
    """Müller, section 5: mass and inertia of a box, printed with six digits."""
    body = lierb.bodies.box((0.3, 0.15, 0.05), density=2700.0)
    assert body.mass == pytest.approx(6.075)
    np.testing.assert_allclose(np.diag(body.inertia), (0.0126563, 0.0468281, 0.0569531), rtol=4e-6)


def test_rod_is_a_slender_cylinder():
    rod = lierb.bodies.rod(2.0, 1e-3, mass=0.6)
    assert np.diag(rod.inertia) == pytest.approx([0.6 * 4 / 12, 0.6 * 4 / 12, 3e-7], rel=1e-6)


def test_each_member_of_a_batch_is_what_it_is_alone():
    radii, masses = np.array((0.1, 0.2, 0.3)), np.array((1.0, 2.0, 5.0))
    together = lierb.bodies.cylinder(radii, 0.7, mass=masses)
    for i in range(3):
        alone = lierb.bodies.cylinder(radii[i], 0.7, mass=masses[i])
        np.testing.assert_array_equal(together.inertia[i], alone.inertia)
    shared = lierb.bodies.sphere(radii, mass=2.0)
    assert shared.mass.shape == (3,)


BAD = {
    "neither": (lambda: lierb.bodies.sphere(1.0), "mass= or density="),
    "both": (lambda: lierb.bodies.sphere(1.0, mass=1.0, density=1.0), "mass= or density="),
    "flat box": (lambda: lierb.bodies.box((1.0, 0.0, 1.0), mass=1.0), "size.*positive"),
    "one negative radius": (
        lambda: lierb.bodies.sphere((1.0, -1.0), mass=1.0), r"radius\[1\] is -1.0 m",
    ),
    "no density": (lambda: lierb.bodies.sphere(1.0, density=0.0), "density.*kg/m³"),
    "two sizes": (lambda: lierb.bodies.cylinder(np.ones(2), np.ones(3), mass=1.0), "radius"),
    "size and mass": (lambda: lierb.bodies.sphere(np.ones(2), mass=np.ones(3)), "mass"),
    "not a number": (lambda: lierb.bodies.sphere("wide", mass=1.0), "radius"),
}  # fmt: skip


@pytest.mark.parametrize(("call", "told"), BAD.values(), ids=BAD)
def test_bad_solid_is_refused(call, told):
    with pytest.raises(ArgumentError, match=told):
        call()


# ---- meshes --------------------------------------------------------------------------------------


def test_mesh_of_a_box_is_the_box(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.box(extents=SIZE)
    expected = lierb.bodies.box(SIZE, density=DENSITY)
    mesh.export(tmp_path / "box.stl")
    for given in (mesh, tmp_path / "box.stl", str(tmp_path / "box.stl")):
        found = lierb.bodies.from_mesh(given, density=DENSITY)
        # sums over twelve triangles; STL holds single precision
        rtol = 1e-12 if given is mesh else 1e-6
        np.testing.assert_allclose(found.mass, expected.mass, rtol=rtol)
        np.testing.assert_allclose(found.inertia, expected.inertia, rtol=rtol, atol=1e-6)
        np.testing.assert_allclose(found.com, 0.0, atol=1e-8)


def test_mesh_off_its_centre_moves_as_the_solid_does():
    """One pendulum, its body described about the centre of mass and about a corner."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.box(extents=SIZE)
    corner = np.array(SIZE) / 2
    mesh.apply_translation(corner)
    held = {"axis": (0, 1, 0)}
    ends = []
    for body, point in (
        (lierb.bodies.from_mesh(mesh, mass=MASS), (0.0, 0.0, 0.0)),
        (lierb.bodies.box(SIZE, mass=MASS), -corner),
    ):
        top = lierb.Problem(body, lierb.joints.revolute(point, **held), (0.0, 0.0, -9.81))
        run = integrate(top, twist0=np.zeros(6), dt=1e-2, t_end=1.0)
        ends.append(run.summary["omega"].to_pylist()[0])
    np.testing.assert_allclose(*ends, atol=1e-11)  # 100 steps of rounding


def test_open_mesh_is_refused():
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.box(extents=SIZE)
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    with pytest.raises(ArgumentError, match="watertight"):
        lierb.bodies.from_mesh(mesh, mass=1.0)


def test_what_is_no_mesh_is_refused():
    pytest.importorskip("trimesh")
    with pytest.raises(ArgumentError, match=r"trimesh\.Trimesh"):
        lierb.bodies.from_mesh(np.zeros((3, 3)), mass=1.0)


def test_missing_trimesh_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    with pytest.raises(MissingExtraError, match=r"mesh needs trimesh, .*pip install"):
        lierb.bodies.from_mesh("body.stl", mass=1.0)
