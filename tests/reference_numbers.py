"""Numbers to compare with, as published or computed by others than `lierb` (SI units).

Source of each in the line above it. "Taylor" is a Taylor series integration with 40 digits.
"""

from math import pi

# ---- The box of Müller, BIT 56 (2016), section 5: a point near its corner held at the origin

# Müller, section 5: aluminium, 0.3 x 0.15 x 0.05 m; inertia about the centre of mass, RFR there
BOX_MASS = 6.075
BOX_INERTIA = (0.0126563, 0.0468281, 0.0569531)
# Müller, section 5: the joint's point on the body; the body starts at R = I, r = -point
BOX_POINT = (-0.15, 0.0375, 0.0)
# Müller, section 5.1
BOX_SPHERICAL_OMEGA_0 = (2 * pi, pi, 0.2 * pi)
# Müller, section 5.2; without gravity R is the rotation by 2 pi t about e2, so C(10) = C(0)
BOX_REVOLUTE_OMEGA_0 = (0.0, 2 * pi, 0.0)
# Taylor; spherical, no gravity, t = 1
BOX_SPHERICAL_R_1 = (-0.0688163693517756, 0.0101352830090541, 0.1380863257081105)
# Taylor; spherical, no gravity, t = 1 (body frame)
BOX_SPHERICAL_OMEGA_1 = (6.62714455842339656, 2.03520529910716537, 2.69093051603849920)
# Taylor; spherical, no gravity, t = 10
BOX_SPHERICAL_R_10 = (0.0460324243043289, -0.0291554727452792, 0.1446970086825071)
# Taylor; spherical, no gravity, t = 10 (body frame)
BOX_SPHERICAL_OMEGA_10 = (6.27914296076379745, 3.15175181979597822, -0.569917919131303958)
# Taylor; spherical, gravity (0, 0, -9.81), t = 10
BOX_SPHERICAL_GRAVITY_R_10 = (-0.1383541461527416, -0.0681960782379025, -0.0106618551535703)

# ---- The heavy top of Brüls and Cardona (2010): pivot at the origin, R(0) = I

# Brüls and Cardona, J. Comput. Nonlinear Dynam. 5 (2010) 031002; inertia about the centre of mass
TOP_MASS = 15.0
TOP_INERTIA = (0.234375, 0.46875, 0.234375)
# Brüls and Cardona: from the pivot to the centre of mass; the joint's point on the body is minus it
TOP_CENTRE_OF_MASS = (0.0, 1.0, 0.0)
TOP_OMEGA_0 = (0.0, 150.0, -4.61538)
TOP_GRAVITY = (0.0, 0.0, -9.81)
# Taylor; position of the centre of mass, t = 0.2
TOP_R_02 = (0.60555056137711977, 0.59895768179491916, -0.52398302743000318)
# Taylor; position of the centre of mass, t = 1
TOP_R_1 = (0.17334396409838604, 0.64008859207056878, -0.74849079113358131)
# SciPy's DOP853, rtol 3e-14, on Euler's equations about the pivot; body's axes, t = 1
TOP_OMEGA_1 = (-0.8220781017, 150.0, -5.9232913481)
# The same; force of the joint on the body, m (r̈ − g), in the ground's axes, t = 1
TOP_REACTION_1 = (-517.6007395, -396.8431015, 404.5749252)
# Kynema-FMB, heavy top, generalised-alpha: displacement r - (0, 1, 0) at t = 1; good to about 1e-7
TOP_KYNEMA_DISPLACEMENT_1 = (0.1733440435722807, -0.3599112987333657, -0.7484906793466106)
# Taylor; spatial angular velocity about e2 at t = 2
TOP_SPATIAL_OMEGA_Y_2 = -106.16380414312445
# Exudyn, explicitLieGroupIntegratorTest.py: the same by RKMK4 on SO(3) about the pivot, h = 1e-3.
# It tests the discretisation: its error is that of the method (2.7e-3), not to be improved.
TOP_RKMK4_STEP = 1e-3
TOP_RKMK4_SPATIAL_OMEGA_Y_2 = -106.16651966441937

# ---- Formulas on rotation vectors

# Exudyn, unit tests of rotation vector formulas, values from MATLAB: one RK4 step, torque-free
# (Munthe-Kaas: increments from 0, composed with the old vector; the result keeps an angle above pi.
# RK4 on the vector itself is 5e-14 away.)
ROTATION_VECTOR_INERTIA = (5.2988, 1.1775, 4.3568)
ROTATION_VECTOR_STEP = 1e-3
ROTATION_VECTOR_0 = (1.0, 2.0, 3.0)
ROTATION_VECTOR_OMEGA_0 = (2.0, 4.0, 6.0)
ROTATION_VECTOR_1 = (1.002014565846977, 2.003988840119048, 3.006000763507420)
ROTATION_VECTOR_OMEGA_1 = (1.985608117600764, 3.990428541317109, 6.007531319827856)
# Exudyn, the same tests: (xi, w, dexpinv_so3(xi) w)
DEXPINV_SO3 = (
    (
        (-1.0, -2.0, -3.0),
        (1.0, 1.0, 1.0),
        (-0.402160845072268, 1.774459788731933, 0.951080422536134),
    ),
    (
        (-0.141886338627215, -0.421761282626275, -0.915735525189067),
        (1.0, 1.0, 1.0),
        (0.682902413227995, 1.351928852030877, 0.887043643491090),
    ),
)

# ---- Motions in closed form

# Physical pendulum, axis e2 through the origin, released at rest with its centre at x = length
PENDULUM_MASS = 1.0
PENDULUM_LENGTH = 2.0
# about the centre of mass
PENDULUM_INERTIA = 0.1
PENDULUM_GRAVITY = 9.80665
# Jacobi elliptic functions: centre of mass at t = 5
PENDULUM_X_5 = -1.99968386888353
PENDULUM_Z_5 = -0.0355587475452318
# complete elliptic integral
PENDULUM_PERIOD = 3.39081274198810965

# Kynema-FMB, precession test: a free body with an axis of symmetry, R(0) = I
AXISYMMETRIC_INERTIA = (1.0, 1.0, 0.5)
AXISYMMETRIC_OMEGA_0 = (0.5, 0.5, 1.0)
# Euler's regular precession: quaternion (w, x, y, z) at t = 5; three components have 8 digits
AXISYMMETRIC_QUATERNION_5 = (-0.63051414583893, 0.60480498, -0.30312424, -0.38049775)
