"""Are speed and spin after single contacts right?

    python pipelines/field_contacts.py [DATA] -o OUT [--draws 200]

Gives the contact law of the built-in classes the states before contacts: those filmed at Chant Sura
(A. Caviezel et al. 2020, EnviDat, doi 10.16904/envidat.174), those published for the same slope
(A. Caviezel et al. 2019, Earth Surf. Dynam. 7, 199; G. Lu et al. 2019, Landslides 16, 2353), and
those of blocks in a discrete-element program at the quarry of Authume (Garcia et al. 2022, Eng.
Geol. 310:106855), which is a model too. Writes ``results.json`` and a figure.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from field_cases import tables
from field_cases.contact_scores import (
    by_speed,
    compared,
    filmed,
    measures,
    observed,
    published_grazing,
    simulated,
)
from field_cases.figures import contact_figure
from field_cases.program_contacts import program_contacts
from field_cases.tables import write_json

import sassgis
from sassgis.inputs.ground_map import built_in_table
from sassgis.report.figures import save


def main(argv: list[str] | None = None) -> None:
    """Compare, and write what was found."""
    parser = tables.parser(__doc__)
    parser.add_argument("--draws", type=int, default=200, help="simulations of each contact")
    given = parser.parse_args(argv)
    out: Path = tables.fresh(given.output)
    (out / "notes.txt").write_text("Written by field_contacts.py\n", encoding="utf-8")
    table = built_in_table()
    films, program = filmed(given.data), program_contacts(given.data)
    films_made = simulated(films, table, given.draws)
    program_made = simulated(program, table, max(given.draws // 10, 1))
    grazing, kept = published_grazing(given.data)
    level = simulated(grazing, table, given.draws)
    dip = np.radians(grazing["slope_deg"].to_numpy())[:, None]
    before = np.cos(dip[:, 0]) * grazing["vt_in_mps"] + np.sin(dip[:, 0]) * grazing["vn_in_mps"]
    after = np.cos(dip) * level[..., 0] + np.sin(dip) * level[..., 1]
    write_json(
        out / "results.json",
        {
            "program": f"sassgis {sassgis.__version__}",
            "films": compared(films, films_made),
            "single": [
                {
                    "mass_kg": row["mass_kg"],
                    "vt_mps": row["vt_in_mps"],
                    "vn_mps": row["vn_in_mps"],
                    **compared(films.iloc[[k]], films_made[[k]]),
                }
                for k, row in enumerate(films.to_dict("records"))
            ],
            "grazing": {
                "observed": kept,
                "simulated": np.nanmedian(after, axis=1) / before.to_numpy(),
            },
            "by_speed": by_speed(program, program_made),
        },
    )
    save(
        contact_figure(
            films,
            observed(films)[:, 0],
            measures(films, films_made),
            program,
            observed(program)[:, 0],
            measures(program, program_made),
        ),
        out / "contacts.png",
    )
    print(f"Wrote {out / 'results.json'}")


if __name__ == "__main__":
    tables.in_one_line(main)
