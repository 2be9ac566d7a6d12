"""Names of the integers in the table of a tree in memory, and of rows of a thread's memory.

The table is that of `lierb.kernels.systems.tree_table`. *Rows* are those of a thread's memory,
[row][lane]; *places* are indices into the table.
"""

from __future__ import annotations

from lierb.kernels.systems.measures import JOINT_ERRORS

# Header: numbers of nodes (without the ground), freedoms, links, joints (loops included), roots and
# rows with multipliers; columns of the inputs; columns in which the derivatives of a column 0
# would begin, [column][direction], before those of the inputs, and before those of an end;
(
    NODES, FREEDOMS, LINKS, JOINTS, ROOTS, ROWS,
    JOINT_COLUMN, GRAVITY_COLUMN, START_COLUMN, CHART_COLUMN, V_COLUMN, STATES_COLUMN, SEEDS,
    END_SEEDS,
    # the number of elements, and their place in the table; the place of those that are listed;
    ELEMENTS, ELEMENT_TABLE, LISTED_TABLE,
    # first rows of the nodes' constants; of the state: charts, velocities, joints' JOINT_KEPT;
    CONSTANTS_ROW, DETAILS_ROW, CHART_ROW, V_ROW, KEPT_ROW, STATE_ROWS,
    # and of a stage: X/2 and V, motion, what nodes pass on, slopes of X and V, errors, sums.
    X_ROW, STAGE_ROW, MOTION_ROW, PASSED_ROW, X_SLOPES, V_SLOPES, ERRORS_ROW, SUMS_ROW,
    # loads on the nodes, wrenches of the joints, rows of the elements, and a motion of each.
    LOADS_ROW, WRENCH_ROW, ELEMENT_ROWS, TRAVEL_ROW,
    # Numbers of a state; rows from a state to the one that a step leads to, 0 for one in its place;
    # a copy of that. Numbers of a state at the end of a run; column of a lane's end in inputs; rows
    # of the memory.
    STATE, AHEAD, COPY_ROW, END_COLUMNS, LANE_COLUMN, MEMORY,
    # Numbers and places of constraints, of their equations, and of pairs of them on one path;
    CONSTRAINTS, CONSTRAINT_TABLE, EQUATIONS, EQUATION_TABLE, PAIRS, PAIR_TABLE,
    # first rows of their constants; of u and of (SᵀIS)⁻¹u of the equations; of two wrenches of each
    # equation of one constraint; of S, L and L D of S = L D Lᵀ; of vectors of all equations; and of
    # X by which a projection moves.
    CONSTRAINT_ROWS, LEFT_ROW, WALK_ROW, SCHUR_ROW, LOWER_ROW, SCALED_ROW, VECTOR_ROWS, OFF_ROW,
    HEADER,
) = range(56)  # fmt: skip
# A node's numbers: its kind and that of its joint; its role, and the first node of its joint; its
# parent; rows of its chart; its first freedom; rows of what it passes on, of what its children pass
# on, and of what its next sibling passes on, or 0; its link, or that of the next node for a
# massless one; columns of chart and velocity at the end of a run, and of its joint's first λ.
(
    KIND, JOINT, ROLE, BASE, PARENT, CHART, FREEDOM, PASSES, CHILDREN, SIBLING, LINK, CHART_END,
    V_END, MULTIPLIER, TABLE,
) = range(15)  # fmt: skip
# An element's numbers: its kind, its two nodes, its joint, its first column and its row.
CONNECTION_KIND, NODE, OTHER, ON_JOINT, COLUMN, ROW, ELEMENT = range(7)
# A constraint's part at two nodes has these, and the row of the wrench of its joint. A constraint
# has the numbers of its first part; its first equation and their number; column of λ and row of u;
# places and numbers of the steps of its path and of the legs on it, and the number of freedoms on
# the path; then the numbers of the part at its second joint.
WRENCH, PART = ELEMENT, ELEMENT + 1
FIRST, HOLDS, LAMBDA, LEFT, PATH, STEPS, LEGS, LEG_COUNT, LENGTH, SECOND_PART = range(
    PART, PART + 10
)
CONSTRAINT = SECOND_PART + PART
# A node on a path: its index, the first of its freedoms among those of the path, their number, and
# the row of its ν̇ by loads alone.
PATH_NODE, ON_PATH, MOVES, FORCED, STEP = range(5)
# A leg of a path: the row of the wrenches that it hands on, the row of those that join them first,
# or 0, and the place and number of its steps.
HANDED, JOINING, LEG_STEPS, LEG_LENGTH, LEG = range(5)
# An equation's numbers: the first equation in its row of S, and the row of S at equation 0.
ENVELOPE, AT, EQUATION = range(3)
# A pair's numbers: two constraints, the place and number of the stretches of freedoms on both
# paths. A stretch: its beginnings on both paths, and its length.
AFTER, BEFORE, STRETCHES, COUNT, PAIR = range(5)
ON_AFTER, ON_BEFORE, STRETCH = 0, 1, 3
# Vectors of all equations: J V̇ − η, mobilities, reciprocals of D, L⁻¹(J V̇ − η), 1 for dependent
# rows, λ by both tolerances, prescribed rates.
EXCESS, MOBILITY, INVERSE, REDUCED, IS_DEPENDENT, MULTIPLIERS, SECOND, RATE, VECTORS = range(9)
# Rows of sums over all nodes: energy, orthogonality error, largest errors of the joints, power;
# then 1 where rows contradict each other; numbers of dependent rows by the tolerance of rounding,
# and by that of open rows where it is needed; of a projection, the square of the speed before the
# step and the sum of all numbers of the state.
ENERGY, ORTHOGONALITY, ERRORS, POWER = 0, 1, 2, 2 + len(JOINT_ERRORS)
SINGULAR, DEPENDENT, DROPPED, SPEED, TOTAL, SUMS = range(POWER + 1, POWER + 7)
