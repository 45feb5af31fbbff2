"""Draw the figures of ``figures/`` that a fit makes: SIMULATED demo and MEASURED recordings.

``python studies/pictures.py`` fits each configuration and saves its figures as PDF and PNG (three
CPU minutes); ``python studies/pictures.py emps`` some. Needs ``../shared/data`` except for the
demo. Figures of a single study come from its script.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

FOLDER = Path(__file__).resolve().parent
FIGURES = FOLDER.parent / "figures"
# folder: configuration and its figures
FIGURES_OF = {
    "demo": ("", ("corner", "methods", "prediction", "friction", "ridge")),
    "emps": ("emps/emps-white.toml", ("corner", "methods", "prediction", "friction")),
    "ur10e": ("ur10e/ur10e-joint2.toml", ("corner", "methods", "prediction", "friction")),
    "xl330": ("xl330/xl330.toml", ("corner", "methods", "prediction", "friction")),
}


def main() -> None:
    """Fit, and copy the figures."""
    for name in sys.argv[1:] or FIGURES_OF:
        config, stems = FIGURES_OF[name]
        with TemporaryDirectory() as folder:
            run = Path(folder, name)
            arguments = ("fit", FOLDER / config) if config else ("demo",)
            command = [sys.executable, "-m", "bayesfric"]
            # exit code 3: sampled, with warnings; figures exist
            completed = subprocess.run([*command, *arguments, "-o", run], check=False)
            if completed.returncode not in (0, 3):
                sys.exit(completed.returncode)
            subprocess.run([*command, "report", run, "--paper"], check=True)
            target = FIGURES / name
            shutil.rmtree(target, ignore_errors=True)
            target.mkdir(parents=True)
            for stem in stems:
                for kind in ("pdf", "png"):
                    shutil.copy(run / "figures" / f"{stem}.{kind}", target)


if __name__ == "__main__":
    main()
