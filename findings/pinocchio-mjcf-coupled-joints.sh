#!/usr/bin/env bash
# Pinocchio 4.1.0 reads an MJCF whose fingers are coupled by <equality><joint> as two free joints,
# without a warning, also by the reader that is asked for constraints. MuJoCo 4.0.0 couples them.
#
# Seen on Python 3.11.7, x86_64 Linux: with a force of 1 N at the left finger alone MuJoCo moves
# both fingers alike; Pinocchio has no constraint, no mimicking joint, and moves the left one only.
# Exits with 1 if that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pin==4.1.0 mujoco==4.0.0
cd "$folder"
cat > gripper.xml <<'XML'
<mujoco model="gripper">
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="palm">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body name="left" pos="0 0.02 0">
        <joint name="left" type="slide" axis="0 1 0"/>
        <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
      </body>
      <body name="right" pos="0 -0.02 0">
        <joint name="right" type="slide" axis="0 -1 0"/>
        <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/></equality>
</mujoco>
XML
"$folder/venv/bin/python" - <<'PYTHON'
import mujoco
import numpy as np
import pinocchio

model = mujoco.MjModel.from_xml_path("gripper.xml")
data = mujoco.MjData(model)
data.qfrc_applied[:] = [1.0, 0.0]
while data.time < 0.1:
    mujoco.mj_step(model, data)
print("MuJoCo", mujoco.__version__, "travel of left and right, m:", data.qpos.round(4))
coupled = abs(data.qpos[0] - data.qpos[1]) < 0.1 * data.qpos[0]

read, points, frames = pinocchio.buildModelAndConstraintsFromMJCF("gripper.xml")
left, right = pinocchio.aba(
    read, read.createData(), np.zeros(2), np.zeros(2), np.array([1.0, 0.0])
)
print("Pinocchio", pinocchio.__version__, "degrees of freedom:", read.nv)
print("constraints:", len(points) + len(frames), "mimicking:", len(list(read.mimicking_joints)))
print("acceleration of left and right, m/s^2:", left, right)
free = read.nv == 2 and len(points) + len(frames) == 0 and left > 1.0 and right == 0.0
raise SystemExit(0 if coupled and free else 1)
PYTHON
