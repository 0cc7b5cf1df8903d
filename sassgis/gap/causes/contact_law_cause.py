"""Another law of the contact: the same shift for all sizes. It belongs to the base."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sassgis.gap.causes.cause import Cause, CausePart, ParameterDraws, rounded
from sassgis.gap.constants import LAW_BOUNDS, RESTITUTION_SPEED_MPS
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.observations.case import Case
from sassgis.settings.ground import GroundTable


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    """Return freedom of the contact beyond calibration.

    Where contacts were recorded, it is as they have it (``learned_contacts``), and rolling is
    shifted alike for all classes. Else all parameters have one shift, in wide ranges: classes keep
    the differences between them. From the highest speeds on the restitution hardly falls with the
    normal speed.
    """
    shifts = {"mu_0": draws.uniform("law.mu_0", -0.3, 0.3)}
    values: dict[str, float] = {}
    if case.learned is None:
        shifts |= {
            "eta_max": draws.uniform("law.eta_max", -0.5, 0.5),
            "mu_f": draws.uniform("law.mu_f", -0.6, 0.6),
        }
        if case.engine.resolved().eta_max_rule == "restitution":
            shifts["restitution"] = draws.uniform("law.restitution", -0.6, 0.6)
            shifts["mu_v"] = draws.uniform("law.mu_v", -0.02, 0.02)
            halved = draws.log("law.restitution_speed", 1.0 / 12.0, 12.0)
            values["restitution_speed_mps"] = rounded(halved * RESTITUTION_SPEED_MPS)
    used = np.unique(case.profiles.ground).tolist()

    def change(model: HypothesisModel) -> HypothesisModel:
        classes = list(model.table.classes)
        for k in used:
            by, own = dict(shifts), dict(values)
            if case.learned is not None:
                # How far the contacts recorded on a class are from what is configured.
                learned, configured = case.learned.table.classes[k], case.table.classes[k]
                own["restitution_speed_mps"] = learned.restitution_speed_mps
                for name in ("eta_max", "mu_f", "restitution", "mu_v"):
                    by[name] = float(getattr(learned, name) - getattr(configured, name))
            for name, shift in by.items():
                low, high = LAW_BOUNDS[name]
                value = float(getattr(classes[k], name)) + shift
                own[name] = rounded(min(max(value, low), high))
            classes[k] = replace(classes[k], **own)
        return replace(model, table=GroundTable(tuple(classes)))

    stated = {f"shift_of_{name}": shift for name, shift in shifts.items()}
    return CausePart("shifted contact", change, stated | values)


CAUSE = Cause(
    "contact_law",
    number=10,
    group="contact",
    phase="impact",
    label="another contact law",
    summary="another contact law: the same shift of rebound and slip for all sizes",
    weighed=False,
    draw=_draw,
    statistics=(),
)
