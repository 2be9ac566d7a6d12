"""Each joint of the catalogue is a list of constraint rows between two frames.

The rows are those of `lierb.kernels.mechanics.rows`, in the order of λ. They act on D = G⁻¹CB =
(Q, d), with G the joint frame in the ground and B in the body: `d1` d_i = 0, `Qtd1`
(Qᵀd)_i = 0, `Q32` Q_ij = 0, `Omega1` Ω_k = 0, `screw` d₃ − pitch·φ = 0, `rod` ‖d‖ = length, `cv`
rotation axis of Q ⊥ e₃.
"""

from typing import TYPE_CHECKING

from lierb.errors import synonyms
from lierb.model.joints.catalogue import *  # noqa: F403
from lierb.model.joints.catalogue import from_rows
from lierb.model.joints.joint import Joint
from lierb.model.joints.joint_type import JOINTS, JointType
from lierb.support.keywords import names_of_module

__all__ = ["JOINTS", "Joint", "JointType", "from_rows", *JOINTS]

if not TYPE_CHECKING:
    __getattr__, __dir__ = names_of_module("lierb.joints", __all__, synonyms.JOINTS)
