"""Names that other tools have for what lierb has, for messages.

They are of SciPy, MATLAB and Julia, and of MuJoCo, URDF, Drake and Pinocchio. Keys of NAMES are in
lower case; the other tables have what to type here.
"""

from __future__ import annotations

METHODS = {
    "rk45": "DP54", "rk23": "BS32", "ode45": "DP54", "ode23": "BS32", "dp5": "DP54", "bs3": "BS32",
    "dp8": "DOP853", "dopri5": "DP54", "vern6": "Verner65", "vern8": "Verner87",
    "vern9": "Verner98", "radau": "Rodas4", "bdf": "Rodas4", "lsoda": "Rodas4", "ode15s": "Rodas4",
    "ode23s": "ROS34PW2", "rosenbrock23": "ROS34PW2", "rkmk4": "RK4", "leapfrog": "Verlet",
    "velocityverlet": "Verlet", "rattle": "RATTLie", "shake": "SHAKELie", "implicit": "Rodas4",
    "implicitfast": "Rodas4", "runge_kutta3": "Kutta3", "implicit_euler": "Rodas4",
}  # fmt: skip
JOINTS = {
    "hinge": "revolute", "continuous": "revolute", "pin": "revolute", "rotary": "revolute",
    "revolutejoint": "revolute", "slide": "prismatic", "slider": "prismatic",
    "linear": "prismatic", "prismaticjoint": "prismatic", "ball": "spherical",
    "socket": "spherical", "ballrpyjoint": "spherical", "weld": "fixed", "weldjoint": "fixed",
    "rigid": "fixed", "floating": "free", "freeflyer": "free", "free_flyer": "free",
    "freejoint": "free", "quaternionfloatingjoint": "free", "rpyfloatingjoint": "free",
    "planarjoint": "planar", "screwjoint": "screw", "helical": "screw", "cardan": "universal",
    "universaljoint": "universal", "jointmodelfreeflyer": "free",
    "jointmodelspherical": "spherical", "jointmodelsphericalzyx": "spherical",
    "jointmodelplanar": "planar",
    "jointmodeluniversal": "universal", "jointmodelhelical": "screw",
    **{f"jointmodelr{axis}": "revolute" for axis in ("x", "y", "z", "evoluteunaligned")},
    **{f"jointmodelrub{axis}": "revolute" for axis in ("x", "y", "z", "evoluteunaligned")},
    **{f"jointmodelp{axis}": "prismatic" for axis in ("x", "y", "z", "rismaticunaligned")},
}  # fmt: skip
DISTRIBUTIONS = {
    "gaussian": "normal", "norm": "normal", "gauss": "normal", "lognorm": "log_normal",
    "lognormal": "log_normal", "truncnorm": "truncated_normal", "choice": "values",
}  # fmt: skip
NAMES = METHODS | JOINTS | DISTRIBUTIONS

FORCES = {
    "spring": "spring_damper, torsional_spring or slide_spring", "damper": "spring_damper",
    "linear_spring": "spring_damper", "gravity": "the argument gravity of the model",
    "actuator": "motor", "position_actuator": "torsional_spring or slide_spring",
    "friction": "joint_friction or slide_friction", "frictionloss": "joint_friction",
    "limit": "joint_limit or slide_limit", "equality": "gear, or a lierb.Loop",
    "mimic": "gear", "external_force": "constant_wrench",
    "contact": "lierb.wrench: lierb has no contacts", "tendon": "lierb.wrench: there are none",
}  # fmt: skip
BODIES = {
    "cuboid": "box", "cube": "box", "capsule": "cylinder", "ellipsoid": "lierb.Body",
    "mesh": "from_mesh", "ball": "sphere", "point": "sphere, with a small radius",
}  # fmt: skip

_STEP, _START = "dt=, the length of the steps", 'save_at=, the times, with record="state"'
ARGUMENTS = {  # of `lierb.integrate`
    "t_span": "t0= and t_end=", "tspan": "t0= and t_end=", "t_final": "t_end=", "tf": "t_end=",
    "duration": "t_end=", "t_eval": _START, "saveat": _START, "dense_output": _START,
    "y0": "pose0= and twist0=", "x0": "pose0= and twist0=",
    "qpos": "pose0=, which mechanism.pose({link: coordinates}) makes",
    "qvel": "twist0=, which mechanism.twist({link: rates}, pose0) makes",
    "q0": "pose0=, which joint.pose or mechanism.pose makes of coordinates",
    "v0": "twist0=, which joint.twist or mechanism.twist makes of rates",
    "omega0": "twist0=joint.twist(omega=…)",
    "max_step": "dt_max=", "min_step": "dt_min=", "first_step": "dt=, with rtol=",
    "timestep": _STEP, "time_step": _STEP, "step_size": _STEP, "step": _STEP, "h": _STEP,
    "integrator": "method=", "abstol": "atol=", "reltol": "rtol=", "tol": "rtol=",
    "args": "parameters of a lierb.wrench", "fun": "a lierb.Problem with forces of lierb.wrench",
    "jac": "nothing: lierb differentiates your functions",
    "vectorized": "nothing: lierb runs your functions for many bodies at once",
    "callback": "events=, made by lierb.event, or a lierb.controller of the problem",
    "n_jobs": "threads=", "workers": "threads=", "nthread": "threads=",
    **{
        each: f"{each}= to lierb.Problem, lierb.Mechanism or their method with_"
        for each in ("forces", "gravity", "constraints", "observables", "states", "controllers")
    },
}  # fmt: skip
JOINT_ARGUMENTS = {
    "pos": "body_point=, and ground_point= or parent_point= on the other side",
    "anchor": "body_point=, and ground_point= or parent_point= on the other side",
    "point": "body_point=, and ground_point= or parent_point= on the other side",
    "origin": "parent_frame=, and body_frame= on the body's side",
    "xyz": "parent_point=", "placement": "parent_frame=", "direction": "axis=",
    "name": "the name to lierb.Link", "parent": "parent= to lierb.Link",
    "child": "the joint to the child's lierb.Link",
    "range": "lierb.forces.joint_limit to the model",
    "limit": "lierb.forces.joint_limit to the model",
    "limits": "lierb.forces.joint_limit to the model",
    "damping": "lierb.forces.torsional_spring(damping=…) to the model",
    "stiffness": "lierb.forces.torsional_spring(stiffness=…) to the model",
    "springref": "lierb.forces.torsional_spring(angle=…) to the model",
    "frictionloss": "lierb.forces.joint_friction to the model",
    "armature": "a larger inertia to the body",
}  # fmt: skip
BODY_ARGUMENTS = {
    "diaginertia": 'inertia=, with about="com"', "fullinertia": 'inertia=, 3×3, with about="com"',
    "moments": "inertia=", "moment_of_inertia": "inertia=", "I": "inertia=", "m": "mass=",
    "cog": "com=", "center_of_mass": "com=", "centre_of_mass": "com=", "lever": "com=",
    "pos": "com=", "ipos": "com=", "density": "it to a shape of lierb.bodies",
}  # fmt: skip
_STATES = "t, rotation, quaternion, position, omega and v"
RESULTS = {  # attributes of a result
    "y": f"{_STATES}; save_at= and record=\"state\" save a history", "ys": _STATES, "x": _STATES,
    "sol": f"{_STATES} at the times of save_at=", "u": _STATES,
    "t_events": "event_times(name), or the table events", "y_events": "the table events",
    "success": "failed, which is empty after a success", "status": '["status"]',
    "message": 'failed and ["status"]', "nfev": '["steps"] and ["rejected"]',
    "nsteps": '["steps"]',
    "qpos": "rotation and position; mechanism.coordinates({link: poses}) has those of joints",
    "qvel": "omega and v; mechanism.velocities({link: twists}, {link: poses}) has those of joints",
    "qacc": "an observable, whose arguments alpha and specific_force are accelerations",
    "q": "quaternion, rotation or position", "quat": "quaternion", "quaternions": "quaternion",
    "xquat": "quaternion", "xmat": "rotation", "xpos": "position", "pos": "position",
    "R": "rotation", "r": "position", "rotations": "rotation", "positions": "position",
    "cvel": "omega and v", "velocity": "v, in body axes", "angular_velocity": "omega",
    "twist": "omega and v", "pose": "rotation and position", "poses": "rotation and position",
    "time": "t", "times": "t", "ts": "t", "energy": '["energy"], with record="energy"',
    "work": '["work"], with record="energy"', "reaction": '["reaction"], with record="reaction"',
    "observables": "[name] for each", "final": "end, or the table summary",
}  # fmt: skip


def here(name: object, known: dict[str, str]) -> str | None:
    """Return what to take for a name elsewhere, if that is among the known names.

    known : names here, by their names in lower case.
    """
    if not isinstance(name, str):
        return None
    if arguments := ARGUMENTS.get(name):
        return arguments if any(f"{each}=" in arguments for each in known) else None
    found = known.get(NAMES.get(name.lower(), "").lower())
    return repr(found) if found else None
