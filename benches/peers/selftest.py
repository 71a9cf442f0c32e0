"""Checks of these scripts that need no package: `python3 benches/peers/selftest.py`."""

import ast
import math
import sys
import unittest
from pathlib import Path

import measure
import pybullet_rollout
import run

HERE = Path(__file__).resolve().parent


class Selftest(unittest.TestCase):
    def test_every_script_parses(self):
        for script in HERE.glob("*.py"):
            ast.parse(script.read_text(), str(script))

    def test_requirements_are_pinned(self):
        lines = [l for l in (HERE / "requirements.txt").read_text().splitlines() if l and not l.startswith("#")]
        self.assertTrue(lines and all("==" in l for l in lines))

    def test_a_child_is_measured(self):
        code = "x = bytearray(80_000_000); print('noise'); print('{\"a\": 1}')"
        done = measure.run([sys.executable, "-c", code], 60)
        self.assertEqual((done.code, done.json()), (0, {"a": 1}))
        self.assertGreater(done.peak_bytes, 80_000_000)
        self.assertGreater(done.cpu_s, 0.0)

    def test_failures_say_why(self):
        done = measure.run([sys.executable, "-c", "raise SystemExit('no module')"], 60)
        self.assertEqual((done.code, done.why()), (1, "no module"))
        late = measure.run([sys.executable, "-c", "import time; time.sleep(60)"], 0.5)
        self.assertTrue(late.timed_out and late.code != 0 and "stopped" in late.why())
        self.assertEqual(measure.run(["/no/such/program"], 1).code, 127)

    def test_the_table_averages_and_shows_what_is_missing(self):
        rows = [
            run.Row("a", "s1", {"seconds": 1.0, "median": 0.001}),
            run.Row("a", "s2", {"seconds": 3.0, "median": 0.002}),
            run.Row("b", "s1", {}, "did not run: no module"),
            run.Row("b", "s2", {"seconds": 4.0}),
        ]
        mean = run.average(rows[:2])
        self.assertTrue(math.isclose(mean.figures["median"], 0.0015) and mean.figures["seconds"] == 2.0)
        text = run.table(rows)
        self.assertIn("| a | 2.0 |", text)
        self.assertIn("1.500", text)
        self.assertIn("did not run: no module", text)
        self.assertEqual(run.average(rows[2:]).figures, {"seconds": 4.0})
        self.assertIn("1 of 2 scenes", run.average(rows[2:]).notes)

    def test_the_arms_sweep_passes_the_contact_at_its_speed(self):
        for speed in (0.3, 0.8):
            duration, h = 0.4 / speed, 1e-6
            distance, at_contact, gain = pybullet_rollout.travel(speed, 0.5 * duration)
            self.assertTrue(math.isclose(distance, 0.1) and math.isclose(at_contact, speed) and abs(gain) < 1e-9)
            for share in (0.05, 0.17, 0.33, 0.45, 0.55, 0.8, 0.97):
                t = share * duration
                before, now, after = (pybullet_rollout.travel(speed, t + dt) for dt in (-h, 0.0, h))
                self.assertAlmostEqual((after[0] - before[0]) / (2 * h), now[1], delta=1e-6)
                self.assertAlmostEqual((after[1] - before[1]) / (2 * h), now[2], delta=1e-3)

    def test_the_robot_of_the_rollout_has_no_shape_but_the_fist(self):
        text = (HERE.parent.parent / "crates/sms-robots/assets/fr3.urdf").read_text()
        made = pybullet_rollout.robot_urdf(text, [0.01, 0.02, 0.03])
        self.assertEqual((made.count("<collision"), made.count('size="0.02 0.04 0.06"')), (1, 1))
        self.assertEqual(made.count('type="revolute"'), pybullet_rollout.ARM_JOINTS)
        links = made.count("<link name=") - made.count("<link name=\"base")
        self.assertGreaterEqual(made.count("<inertial>"), links - 1)

    def test_the_table_of_rollouts_divides_by_all_of_ours(self):
        text = pybullet_rollout.table([0.01, 0.03], [("peer", 0.2, 0.2)])
        self.assertIn("| 400.0 | 10.0 (engine alone 5.0) |", text)

    def test_metrics_are_picked_by_key(self):
        found = run.pick({"p.holdout_psnr_db": 30.5, "p.f1_2p5mm": None, "q.surface_p90_m": 1.0}, "p.")
        self.assertEqual(found, {"psnr": 30.5})


if __name__ == "__main__":
    unittest.main()
