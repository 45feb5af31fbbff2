#!/usr/bin/env bash
# Pinocchio 4.1.0 reads an MJCF but not the gravity that it states: <option gravity="0 0 -1.62">
# gives a model with 9.81 m/s^2, without a warning. MuJoCo 4.0.0 takes 1.62.
#
# Seen on Python 3.11.7, x86_64 Linux: a pendulum of 2 kg at 0.5 m, horizontal, is held by 1.62 N m
# in MuJoCo and by 9.81 N m in Pinocchio. Exits with 1 if that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pin==4.1.0 mujoco==4.0.0
cd "$folder"
cat > pendulum.xml <<'XML'
<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option gravity="0 0 -1.62"/>
  <worldbody>
    <body name="arm">
      <joint name="pivot" type="hinge" axis="0 1 0"/>
      <inertial pos="0.5 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
    </body>
  </worldbody>
</mujoco>
XML
"$folder/venv/bin/python" - <<'PYTHON'
import mujoco
import numpy as np
import pinocchio

model = mujoco.MjModel.from_xml_path("pendulum.xml")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
held = abs(float(data.qfrc_bias[0]))
print("MuJoCo", mujoco.__version__, "torque that holds it, N m:", round(held, 6))

read = pinocchio.buildModelFromMJCF("pendulum.xml")
zero = np.zeros(1)
other = abs(float(pinocchio.rnea(read, read.createData(), zero, zero, zero)[0]))
print("Pinocchio", pinocchio.__version__, "gravity:", read.gravity.linear, "torque:", round(other, 6))
raise SystemExit(0 if np.isclose(held, 1.62) and np.isclose(other, 9.81) else 1)
PYTHON
