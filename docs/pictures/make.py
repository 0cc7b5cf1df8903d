"""Make the pictures of the README, the gallery and the page on one case from the samples.

``python docs/pictures/make.py`` rewrites the PNG files of this folder;
``python docs/pictures/make.py FOLDER`` writes them somewhere else.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from PIL import Image

from sassgis.inputs.config import load_config
from sassgis.inputs.presets import read_preset
from sassgis.outputs.site_template import sample_folder
from sassgis.report.figures import profile_figure, save
from sassgis.report.figures.hazard_figures import preset_figure
from sassgis.report.map_report import profile_panel
from sassgis.runs import compare
from sassgis.runs.diagnose import diagnose
from sassgis.runs.inputs import profile_from_csv
from sassgis.runs.profile_run import simulate_profile
from sassgis.runs.run import zone
from sassgis.settings.results import StopReason
from sassgis.simulation.path_sample import arrivals

#: Pictures of `sassgis demo` as the program itself draws them, and their names here.
DEMO = {
    "hazard_level": "hazard_level",
    "map_energy": "energy_map",
    "barriers": "walls_and_nets",
    "protection_3": "net_design",
    "hazard_curve": "hazard_curve",
}


def keep(picture: Path, target: Path) -> None:
    """Write a picture in 256 colours, rare ones kept, so that it is small enough for a page."""
    none = Image.Dither.NONE
    with Image.open(picture) as image:
        most = Image.Quantize.MAXCOVERAGE
        small = image.convert("RGB").quantize(256, most, kmeans=2, dither=none)
        small.save(target, optimize=True)


def demo(folder: Path) -> None:
    """Figures of `sassgis demo`."""
    with tempfile.TemporaryDirectory() as work:
        out = Path(work) / "demo"
        zone(sample_folder() / "valley" / "config.toml", out)
        for name, own in DEMO.items():
            keep(out / "figures" / f"{name}.png", folder / f"{own}.png")


def before_and_after(folder: Path) -> None:
    """The Bedrina-like slope without and with its wall and two nets."""
    panels = []
    for name in ("before", "after"):
        config = load_config(sample_folder() / "bedrina" / f"config_{name}.toml")
        result = simulate_profile(config, profile_from_csv(config))
        started = int((result.rocks["reason"] != StopReason.NEVER_STARTED).sum())
        words = f"{name}: {arrivals(result, 'road')} of {started} blocks reach the road"
        panels.append(profile_panel(result, words))
    save(profile_figure(panels), folder / "before_after.png")


def preset(folder: Path) -> None:
    """The matrix of the preset that is the example of its page."""
    example = Path(__file__).parents[1] / "office.toml"
    save(preset_figure(read_preset(example)), folder / "preset_matrix.png")


def map_change(folder: Path) -> None:
    """How the map of the sample changes with the ground calibrated to its observations."""
    with tempfile.TemporaryDirectory() as work:
        samples, out = sample_folder(), Path(work) / "diagnosis"
        config = samples / "valley" / "config.toml"
        diagnose(config, samples / "observed", out, jobs=0)
        compare.map_change(config, out / "model" / "config.toml", out / "map")
        picture = out / "map" / "figures" / "reach_probability_change.png"
        keep(picture, folder / "gap_map_change.png")


def main() -> None:
    """Write all pictures."""
    parser = argparse.ArgumentParser(description="Make the pictures of the documentation.")
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    before_and_after(folder)
    demo(folder)
    map_change(folder)
    preset(folder)


if __name__ == "__main__":
    main()
