"""What each cause leaves behind, tested: numbers whose mean is zero where the cause is absent.

A fingerprint is one number per rock (or per group of rocks); its z is that of the mean over the
groups, with the errors of measurement, of the comparison, and of stated errors that may be wrong
taken off before. No synthetic site is needed for it. The p values are those of Student's t over
groups, adjusted for the number of fingerprints (Holm 1979).
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy import stats

from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.causes.cause import LEAST, Scores, Unseen
from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.inference.rock_tests import holm_adjusted, t_statistics
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.residuals import per_rock
from sassgis.gap.residuals.table import ResidualTable
from sassgis.model.grid import IntArray


def fingerprints(case: Case, residuals: ResidualTable) -> tuple[Fingerprint, ...]:
    """Test every fingerprint on the residuals of a case against its calibrated base.

    The most certain first; those that cannot be seen last.
    """
    group = case.group
    seen, unseen = list[Fingerprint](), list[Fingerprint]()  # p values are adjusted below
    for cause in CAUSES.values():
        for own in cause.statistics:
            with suppress(Unseen):
                scores = own.scores(case, residuals)
                z, p, n = _tested(scores, group)
                if math.isfinite(z):
                    seen.append(Fingerprint(cause.name, own.name, scores.size, z, p, True, n))
                    continue
            none = math.nan
            unseen.append(Fingerprint(cause.name, own.name, none, none, none, False, 0))
    adjusted = holm_adjusted(np.array([one.p_adjusted for one in seen])).tolist()
    seen = [replace(one, p_adjusted=p) for one, p in zip(seen, adjusted, strict=True)]
    return (*sorted(seen, key=lambda one: (one.p_adjusted, -one.z)), *unseen)


def _tested(one: Scores, group: IntArray) -> tuple[float, float, int]:
    """Z of the mean over groups, one-sided p, and groups that have a value."""
    groups = int(group.max()) + 1
    own_null = one.values.size == 1
    values = np.zeros(groups) if own_null else per_rock(one.values, group, groups)
    n = int(np.isfinite(values).sum())
    if n < LEAST:
        return math.nan, math.nan, n
    if one.chance is not None:
        # So few score that their mean is not normal.
        none = np.ones(groups)
        np.multiply.at(none, group, 1.0 - one.chance)
        seem = stats.poisson(float((1.0 - none).sum()))
        hit = int((np.nan_to_num(values) > 0.0).sum())
        p = float(np.clip(seem.sf(hit) + 0.5 * seem.pmf(hit), 1e-30, 1.0 - 1e-9))
        return float(stats.norm.isf(p)), p, n
    if own_null:
        return float(one.values[0]), float(stats.norm.sf(one.values[0])), n
    t = float(np.clip(np.nan_to_num(t_statistics(values)[0], posinf=40.0, neginf=-40.0), -40, 40))
    p = float(stats.t.sf(t, n - 1))
    # The normal deviate of the same chance: a t of five rocks is not one of a hundred.
    z = float(np.clip(stats.norm.isf(p), -12.0, 12.0)) if 0.0 < p < 1.0 else math.copysign(12.0, t)
    return z, p, n
