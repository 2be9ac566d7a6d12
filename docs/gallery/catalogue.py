"""Every joint of the catalogue: which of its rows each c-space keeps exactly."""

import sys

import matplotlib.pyplot as plt

import lierb

COLOURS = {"SE3": "#0072B2", "SO3xR3": "#D55E00"}
NEEDS = {"pitch": 0.07, "length": 0.35}
box = lierb.bodies.box((0.3, 0.15, 0.05), density=2700.0)
names = [name for name, entry in lierb.joints.JOINTS.items() if entry.rows and name != "fixed"]
joints = [
    lierb.joints.JOINTS[name](
        body_point=(-0.15, 0.0375, 0.0),
        **{k: value for k, value in NEEDS.items() if k in lierb.joints.JOINTS[name].options},
    )
    for name in names
]

figure, ax = plt.subplots(figsize=(7.2, 8.4), layout="constrained")
for line, joint in enumerate(joints):
    predictions = lierb.predict(lierb.Problem(box, joint))
    for column, cspace in enumerate(("SE3", "SO3xR3")):
        found = predictions[cspace]
        for place, (row, exact) in enumerate(zip(found.rows, found.rows_exact)):
            ax.scatter(8.5 * column + place, line, s=130, marker="o" if exact else "X",
                       color=COLOURS[cspace] if exact else "0.25")  # fmt: skip
            ax.annotate(row.replace("Omega", "Ω"), (8.5 * column + place, line), xytext=(0, 8),
                        textcoords="offset points", ha="center", color="0.3", size=8)  # fmt: skip
ax.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
ax.set_xticks([2.0, 10.5], ["SE(3)", "SO(3)×R³"], fontsize=12, fontweight="bold")
ax.set(xlim=(-0.8, 14.2), ylim=(len(names) - 0.4, -0.9))
ax.xaxis.tick_top()
ax.tick_params(length=0)
ax.spines[:].set_visible(False)
figure.supxlabel("●  kept exactly        ✖  drifts with the method's order", fontsize=10)

if __name__ == "__main__":
    figure.savefig(sys.argv[1], dpi=130) if sys.argv[1:] else plt.show()
