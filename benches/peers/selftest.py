"""Checks of these scripts that need no package: `python3 benches/peers/selftest.py`."""

import ast
import math
import sys
import unittest
from pathlib import Path

import measure
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

    def test_metrics_are_picked_by_key(self):
        found = run.pick({"p.holdout_psnr_db": 30.5, "p.f1_2p5mm": None, "q.surface_p90_m": 1.0}, "p.")
        self.assertEqual(found, {"psnr": 30.5})


if __name__ == "__main__":
    unittest.main()
