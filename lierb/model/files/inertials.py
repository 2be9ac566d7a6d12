"""Compile a model with inertials that MuJoCo refuses.

MuJoCo checks each body without the bodies welded to it, and refuses a moving body below mjMINVAL
(1e-15 kg or kg m²). Such inertials are removed from the specification and inserted into the
compiled model. `lierb.model.files.welded_bodies` checks each moving body together with those
welded to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lierb.support.arrays import Array

if TYPE_CHECKING:
    from mujoco import MjModel, MjsBody, MjsCompiler, MjSpec

SMALL = 1e-12  # kg or kg m², well above mjMINVAL
HEAVIER = 2.0**60  # factor, a power of two to avoid rounding
TRIANGLE = 1e-6  # well above the rounding by which flat bodies violate A + B ≥ C


class SetAside(NamedTuple):
    """An inertial of a file is set aside.

    inertia : (3, 3), about the centre of mass, in the inertial frame.
    """

    body: MjsBody
    mass: float
    inertia: Array


def compiled(spec: MjSpec) -> MjModel:
    """Compile a specification to a model with exactly the specification's inertials."""
    import mujoco

    total, spec.compiler.settotalmass = spec.compiler.settotalmass, -1.0
    # MuJoCo computes the stiffness of a springdamper from the inertia that it compiles.
    is_free = not any(np.any(joint.springdamper) for joint in spec.joints)
    aside = _set_aside(spec) if is_free else []
    try:
        model = spec.compile()
    except ValueError as error:
        if not (is_free and "mjMINVAL" in str(error) and _adopt(spec)):
            raise
        aside += _set_aside(spec)
        model = spec.compile()
    for each in aside:
        _put_back(model, spec.compiler, each)
    if total > 0.0:
        mujoco.mj_setTotalmass(model, total)
    return model


def _set_aside(spec: MjSpec) -> list[SetAside]:
    """Replace inertials that MuJoCo may refuse or round by unit ones; return the originals."""
    from mujoco import mjtInertiaFromGeom

    is_of_geoms = spec.compiler.inertiafromgeom == mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    aside = []
    for body in spec.bodies[1:]:
        if body.geoms and (is_of_geoms or not body.explicitinertial):
            continue
        mass, inertia = _inertial(body)
        is_full = not np.isnan(body.fullinertia[0])  # earlier releases compute its axes to 1e-9
        if is_full or _is_doubtful(mass, inertia):
            aside.append(SetAside(body, mass, inertia))
            body.mass, body.inertia, body.fullinertia = 1.0, np.ones(3), np.full(6, np.nan)
            body.ipos = np.nan_to_num(body.ipos)  # NaN where the file has no <inertial>
            body.explicitinertial = True
    return aside


def _inertial(body: MjsBody) -> tuple[float, Array]:
    if not body.explicitinertial:
        return 0.0, np.zeros((3, 3))
    if np.isnan(body.fullinertia[0]):
        return float(body.mass), np.diag(body.inertia)
    xx, yy, zz, xy, xz, yz = body.fullinertia
    return float(body.mass), np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


def _is_doubtful(mass: float, inertia: Array) -> bool:
    least, middle, most = np.linalg.eigvalsh(inertia)
    return bool(min(mass, least) < SMALL or most > (1.0 - TRIANGLE) * (least + middle))


def _adopt(spec: MjSpec) -> bool:
    """Convert the inertias of geoms to inertials; return False if the release cannot."""
    from mujoco import mjtInertiaFromGeom

    kind, with_geoms = spec.compiler.inertiafromgeom, [b for b in spec.bodies[1:] if b.geoms]
    is_given = any(body.explicitinertial for body in with_geoms)  # and not overridden by `adopt`
    is_automatic = kind == mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    is_of_geoms = kind == mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE and not is_given
    if not ((is_automatic or is_of_geoms) and hasattr(spec, "adopt_inertial")):
        return False
    spec.compiler.inertiafromgeom = mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    for geom in spec.geoms:  # MuJoCo skips geoms below mjMINVAL
        geom.mass, geom.density = geom.mass * HEAVIER, geom.density * HEAVIER
    for body in with_geoms:
        if not body.explicitinertial:
            spec.adopt_inertial(body)
            body.mass, body.inertia = body.mass / HEAVIER, body.inertia / HEAVIER
    return True


def _put_back(model: MjModel, compiler: MjsCompiler, aside: SetAside) -> None:
    """Insert a body's original inertial, within the bounds that the file sets."""
    from mujoco import mju_mat2Quat, mju_mulQuat

    i, turn = aside.body.id, np.empty(4)
    moments, axes = np.linalg.eigh(aside.inertia)
    mju_mat2Quat(turn, (axes * np.sign(np.linalg.det(axes))).ravel())
    mju_mulQuat(model.body_iquat[i], model.body_iquat[i].copy(), turn)
    mass = aside.mass
    if compiler.boundmass > 0.0:
        mass = max(mass, compiler.boundmass)
    if compiler.boundinertia > 0.0:
        moments = np.maximum(moments, compiler.boundinertia)
    if compiler.balanceinertia and moments[0] + moments[1] < moments[2]:
        moments = np.full(3, moments.mean())
    model.body_mass[i], model.body_inertia[i] = mass, moments
