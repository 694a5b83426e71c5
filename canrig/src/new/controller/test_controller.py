"""The limits of the scenario, and the same frames in two runs: python3 -m unittest"""

import os
import subprocess
import unittest


class Controller(unittest.TestCase):
    def test_it_keeps_to_the_limits_and_repeats_itself(self):
        canrig = os.environ.get("CANRIG", "canrig")
        run = subprocess.run([canrig, "simulate", "--twice", "my_controller.toml"], capture_output=True, text=True)
        self.assertEqual(run.returncode, 0, run.stdout + run.stderr)


if __name__ == "__main__":
    unittest.main()
