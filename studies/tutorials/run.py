"""Run the tutorials and save their outputs.

``python studies/tutorials/run.py`` runs all seven, ``run.py first_joint a_fleet`` some of them;
``--check`` saves nothing. Needs ``pip install '.[tutorials]'``.
"""

from __future__ import annotations

import base64
import io
import os
import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).resolve().parent
NAMES = (
    "first_joint",
    "what_the_data_cannot_tell",
    "which_friction_model",
    "commands_and_encoders",
    "to_mujoco_and_a_controller",
    "a_fleet",
    "a_whole_arm",
)
SECONDS = 600  # limit per cell
COLOURS = 48  # of a picture, for small files


def executed(name: str) -> nbformat.NotebookNode:
    """Run one tutorial in a new kernel of this Python and return it with its outputs."""
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    # cells that begin with ! call the command of this Python
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    place = {"metadata": {"path": str(FOLDER)}}
    NotebookClient(
        notebook, timeout=SECONDS, kernel_name="python3", resources=place, coalesce_streams=True
    ).execute()
    return notebook


def small(png: str) -> str:
    """Reduce the colours of a PNG picture in base64."""
    buffer = io.BytesIO()
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return base64.b64encode(buffer.getvalue()).decode()


def bare(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Remove metadata that differs between runs or machines."""
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for n, cell in enumerate(notebook.cells):
        cell.metadata, cell.id = {}, f"cell-{n:02d}"
        for output in cell.get("outputs", ()):
            if output.output_type == "stream":
                output.text = output.text.replace("\r\n", "\n")
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = small(output.data["image/png"])
    return notebook


def main(words: list[str]) -> None:
    names = [word for word in words if not word.startswith("--")] or list(NAMES)
    for name in names:
        began = time.monotonic()
        notebook = bare(executed(name))
        if "--check" not in words:
            nbformat.write(notebook, FOLDER / f"{name}.ipynb")
        print(f"{name}: {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
