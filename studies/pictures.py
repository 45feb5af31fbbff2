"""The figures of ``figures/`` that a fit makes: of the SIMULATED demo and of MEASURED recordings.

``python studies/pictures.py`` fits each configuration anew and keeps its figures as PDF and PNG,
three CPU minutes; ``python studies/pictures.py emps`` some. Needs ``../shared/data`` but for the
demo. Those of one study alone are made by its own script.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
FIGURES = HERE.parent / "figures"
# folder: configuration, and which of its figures
WANTED = {
    "demo": ("", ("corner", "methods", "prediction", "friction", "ridge")),
    "emps": ("emps/emps-white.toml", ("corner", "methods", "prediction", "friction")),
    "ur10e": ("ur10e/ur10e-joint2.toml", ("corner", "methods", "prediction", "friction")),
    "xl330": ("xl330/xl330.toml", ("corner", "methods", "prediction", "friction")),
}


def main() -> None:
    """Fit, and put the figures in their place."""
    for name in sys.argv[1:] or WANTED:
        config, stems = WANTED[name]
        with TemporaryDirectory() as folder:
            run = Path(folder, name)
            words = ("fit", HERE / config) if config else ("demo",)
            command = [sys.executable, "-m", "bayesfric"]
            # 3: sampled, and something to know; the figures are made
            done = subprocess.run([*command, *words, "-o", run], check=False)
            if done.returncode not in (0, 3):
                sys.exit(done.returncode)
            subprocess.run([*command, "report", run, "--paper"], check=True)
            target = FIGURES / name
            shutil.rmtree(target, ignore_errors=True)
            target.mkdir(parents=True)
            for stem in stems:
                for kind in ("pdf", "png"):
                    shutil.copy(run / "figures" / f"{stem}.{kind}", target)


if __name__ == "__main__":
    main()
