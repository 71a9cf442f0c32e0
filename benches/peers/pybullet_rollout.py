"""One evaluation of the planner in PyBullet and in ours: the arm strikes a ball among eight vessels of eight hulls under
operational-space torque control at 400 Hz, four seconds in all.

    python benches/peers/pybullet_rollout.py --sms target/release/sms --out runs/pybullet

`sms bench plan --export` times our evaluations on one thread and writes the scene (URDF), the robot and the strikes; each is
then carried out in PyBullet, in the same run on the same machine, one thread, nothing rendered. Times are CPU seconds. Only the
fist touches anything in either. The sweep over, the arm is taken out of the world in both. Not in PyBullet's time: loading the
scene and the robot, and finding the arm's posture; in ours, planning the sweep is counted apart and in the sum. Needs numpy and
pybullet.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import measure

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TOOL = "fr3_fist"
ARM_JOINTS = 7


def travel(speed: float, t: float) -> tuple[float, float, float]:
    """Distance, speed and acceleration of a sweep of two 0.1 m segments: the smooth profile of `sms-robots`."""
    half = 0.2 / speed
    if t <= 0.0 or t >= 2.0 * half:
        return (0.0 if t <= 0.0 else 0.2), 0.0, 0.0
    rising = t < half
    p, v, a = rise(t / half if rising else 2.0 - t / half)
    distance, speed_now, gain = speed * half * p, speed * v, speed / half * a
    return (distance, speed_now, gain) if rising else (0.2 - distance, speed_now, -gain)


def rise(s: float) -> tuple[float, float, float]:
    """A rise from rest to unit speed in unit time with a trapezoid of acceleration: distance, speed, acceleration."""
    ramp, peak = 0.4, 1.0 / 0.6
    if s < ramp:
        return peak * s**3 / (6 * ramp), peak * s * s / (2 * ramp), peak * s / ramp
    if s <= 1.0 - ramp:
        p, v, _ = rise(ramp - 1e-15)
        t = s - ramp
        return p + v * t + 0.5 * peak * t * t, v + peak * t, peak
    p, v, a = rise(1.0 - s)
    return s - 0.5 + p, 1.0 - v, a


def robot_urdf(text: str, half: list[float]) -> str:
    """The robot as PyBullet can use it: no shape but the fist's, joints of the fingers fixed, links without mass given
    next to none (PyBullet would give them 1 kg)."""
    text = re.sub(r"<collision>.*?</collision>|<collision .*?</collision>", "", text, flags=re.S)
    text = text.replace('type="prismatic"', 'type="fixed"')
    light = '<inertial><mass value="1e-6"/><inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial>'
    size = " ".join(str(2 * h) for h in half)
    fist = f'<collision><geometry><box size="{size}"/></geometry></collision>'
    text = re.sub(rf'<link name="{TOOL}"\s*/>', f'<link name="{TOOL}">{light}{fist}</link>', text)
    return re.sub(r'<link name="([^"]+)"\s*/>', rf'<link name="\1">{light}</link>', text)


@dataclass
class Shot:
    """Seconds of one evaluation, and what came out."""

    engine_s: float
    control_s: float
    contact_speed: float
    cue_moved_m: float


class Peer:
    """PyBullet with the scene and the robot."""

    def __init__(self, folder: Path, dt: float, iterations: int, sleep: bool):
        import numpy
        import pybullet

        self.np, self.p = numpy, pybullet
        self.folder, self.dt, self.iterations, self.sleep = folder, dt, iterations, sleep
        self.job = json.loads((folder / "strikes.json").read_text())
        spec = importlib.util.spec_from_file_location("scene_loader", folder / "scene" / "load_pybullet.py")
        self.loader = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self.loader)
        self.urdf = folder / "fr3_fist_only.urdf"
        self.urdf.write_text(robot_urdf((folder / "fr3.urdf").read_text(), self.job["tool_half"]))
        pybullet.connect(pybullet.DIRECT)

    def load(self, strike: dict) -> None:
        p = self.p
        p.resetSimulation()
        self.bodies = self.loader.load(p)
        p.setPhysicsEngineParameter(fixedTimeStep=self.dt, numSolverIterations=self.iterations)
        if self.sleep:
            for body in self.bodies.values():
                p.changeDynamics(body, -1, activationState=p.ACTIVATION_STATE_ENABLE_SLEEPING)
        self.arm = p.loadURDF(str(self.urdf), basePosition=self.job["base_w"], useFixedBase=True)
        named = {p.getJointInfo(self.arm, j)[12].decode(): j for j in range(p.getNumJoints(self.arm))}
        self.tool = named[TOOL]
        self.joints = [j for j in range(p.getNumJoints(self.arm)) if p.getJointInfo(self.arm, j)[2] == p.JOINT_REVOLUTE]
        assert len(self.joints) == ARM_JOINTS
        self.efforts = self.np.array([p.getJointInfo(self.arm, j)[10] for j in self.joints])
        for j, q in zip(self.joints, strike["q_start"]):
            p.resetJointState(self.arm, j, q)
            # Motors off, no damping: torques alone move it.
            p.setJointMotorControl2(self.arm, j, p.VELOCITY_CONTROL, force=0)
        for link in range(-1, p.getNumJoints(self.arm)):
            p.changeDynamics(self.arm, link, linearDamping=0, angularDamping=0, jointDamping=0)
        p.changeDynamics(
            self.arm,
            self.tool,
            lateralFriction=self.job["striker_friction"],
            restitution=self.job["striker_restitution"],
        )
        self.last = self.np.array(p.calculateInverseDynamics(self.arm, strike["q_start"], [0.0] * 7, [0.0] * 7))

    def torques(self, strike: dict, t: float):
        """Operational-space control as `sms-robots` does it, with the robot's dynamics from PyBullet."""
        np, p, osc = self.np, self.p, self.job["osc"]
        states = p.getJointStates(self.arm, self.joints)
        q, qd = [s[0] for s in states], [s[1] for s in states]
        zero = [0.0] * ARM_JOINTS
        mass = np.array(p.calculateMassMatrix(self.arm, q))
        bias = np.array(p.calculateInverseDynamics(self.arm, q, qd, zero))
        link = p.getLinkState(self.arm, self.tool, computeLinkVelocity=1, computeForwardKinematics=1)
        position, velocity, spin = np.array(link[4]), np.array(link[6]), np.array(link[7])
        jacobian = np.vstack(p.calculateJacobian(self.arm, self.tool, (0, 0, 0), q, qd, zero))
        h = 1e-6
        ahead = np.vstack(p.calculateJacobian(self.arm, self.tool, (0, 0, 0), [a + h * b for a, b in zip(q, qd)], qd, zero))
        speeds = np.array(qd)
        drift = (ahead - jacobian) @ speeds / h
        distance, speed, _ = travel(strike["speed"], t)
        _, _, gain = travel(strike["speed"], t + 0.5 * osc["period_s"])
        d = np.array(strike["direction_w"])
        goal = np.array(strike["contact_w"]) + (distance - 0.1) * d
        turn = p.getDifferenceQuaternion(link[5], strike["rotation_w_xyzw"])
        axis, angle = p.getAxisAngleFromQuaternion(turn)
        angle = angle - 2.0 * np.pi if angle > np.pi else angle
        linear = gain * d + osc["position_stiffness"] * (goal - position) + osc["position_damping"] * (speed * d - velocity)
        angular = osc["rotation_stiffness"] * angle * np.array(axis) - osc["rotation_damping"] * spin
        posture = osc["posture_stiffness"] * (np.array(strike["q_start"]) - np.array(q)) - osc["posture_damping"] * speeds
        wanted = np.concatenate([linear, angular]) - drift - jacobian @ posture
        columns = np.linalg.solve(mass, jacobian.T)
        force = np.linalg.solve(jacobian @ columns + 1e-6 * np.eye(6), wanted)
        tau = np.clip(bias + mass @ (posture + columns @ force), -self.efforts, self.efforts)
        rate = osc["torque_rate"] * osc["period_s"]
        self.last = np.clip(tau, self.last - rate, self.last + rate)
        return self.last

    def shoot(self, strike: dict) -> Shot:
        """One evaluation; loading is not timed."""
        np, p = self.np, self.p
        self.load(strike)
        period, duration = self.job["osc"]["period_s"], 0.4 / strike["speed"]
        d = np.array(strike["direction_w"])
        cue = self.bodies["cue"]
        start = np.array(p.getBasePositionAndOrientation(cue)[0])
        engine_s, control_s, ticks, contact_speed, there = 0.0, 0.0, 0, 0.0, True
        for k in range(round(self.job["horizon_s"] / self.dt)):
            t = k * self.dt
            if there and t > duration:
                began = time.process_time()
                p.removeBody(self.arm)
                engine_s += time.process_time() - began
                there = False
            if there:
                began = time.process_time()
                if ticks * period <= t + 1e-9:
                    tau = self.torques(strike, t)
                    ticks += 1
                p.setJointMotorControlArray(self.arm, self.joints, p.TORQUE_CONTROL, forces=tau)
                control_s += time.process_time() - began
                if contact_speed == 0.0 and t >= 0.5 * duration - 2.5 * self.dt:
                    contact_speed = float(np.dot(p.getLinkState(self.arm, self.tool, computeLinkVelocity=1)[6], d))
            began = time.process_time()
            p.stepSimulation()
            engine_s += time.process_time() - began
        moved = np.array(p.getBasePositionAndOrientation(cue)[0]) - start
        return Shot(engine_s, control_s, contact_speed, float(np.linalg.norm(moved)))


def table(ours: list[float], rows: list[tuple[str, float, float]]) -> str:
    """Markdown of mean milliseconds: ours (planning the sweep, simulating), and of each peer its engine and its control."""
    plan, simulate = (1e3 * s for s in ours)
    text = "| | engine ms | control ms | in all ms | over ours |\n|---|--:|--:|--:|--:|\n"
    text += f"| sms, rollout | | | {simulate:.1f} | |\n| sms, with planning the sweep | | | {plan + simulate:.1f} | 1.0 |\n"
    for name, engine, control in rows:
        e, c = 1e3 * engine, 1e3 * control
        text += f"| {name} | {e:.1f} | {c:.1f} | {e + c:.1f} | {(e + c) / (plan + simulate):.1f} "
        text += f"(engine alone {e / (plan + simulate):.1f}) |\n"
    return text


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sms", type=Path, default=ROOT / "target/release/sms")
    parser.add_argument("--out", type=Path, default=ROOT / "runs/pybullet")
    parser.add_argument("--shots", type=int, default=5, help="strikes carried out in PyBullet, of fifteen")
    parser.add_argument("--iterations", type=int, default=50, help="of PyBullet's solver; 50 is its default")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    command = [str(args.sms), "bench", "plan", "--export", str(args.out), "--quiet"]
    done = measure.run(command, 600, {"RAYON_NUM_THREADS": "1"}, ROOT)
    if done.code != 0:
        print(f"our side did not run: {done.why()}", file=sys.stderr)
        return 1
    ours = json.loads((args.out / "strikes.json").read_text())["ours"]
    rows, record = [], {"ours_s": ours, "iterations": args.iterations}
    for name, dt, sleep in [
        ("PyBullet, steps of 2.5 ms", 0.0025, False),
        ("PyBullet, the same, bodies may sleep", 0.0025, True),
        ("PyBullet, its usual 240 Hz, bodies may sleep", 1.0 / 240.0, True),
    ]:
        peer = Peer(args.out, dt, args.iterations, sleep)
        strikes = peer.job["strikes"]
        chosen = strikes[:: max(1, len(strikes) // args.shots)][: args.shots]
        shots = [peer.shoot(strike) for strike in chosen]
        peer.p.disconnect()
        mean = lambda key: sum(getattr(s, key) for s in shots) / len(shots)
        rows.append((name, mean("engine_s"), mean("control_s")))
        ratios = [s.contact_speed / strike["speed"] for s, strike in zip(shots, chosen)]
        record[name] = [vars(s) for s in shots]
        start = peer.np.array([0.35, 0.0, 0.03])
        moved = [float(peer.np.linalg.norm(peer.np.array(strike["balls_w"][0]) - start)) for strike in chosen]
        print(f"{name}: speed before the contact {min(ratios):.3f} to {max(ratios):.3f} of the asked one; the cue ball moved "
              + ", ".join(f"{s.cue_moved_m:.2f} m (ours {m:.2f})" for s, m in zip(shots, moved)))
    text = table(ours, rows)
    print(text)
    (args.out / "table.md").write_text(text)
    (args.out / "results.json").write_text(json.dumps(record, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
