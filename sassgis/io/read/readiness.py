"""What a configuration is complete for, and what is missing for the rest."""

from __future__ import annotations

from dataclasses import dataclass

from sassgis.model.run_config import Config

#: Keys that say what is at stake at an object, alone or as the attribute of each feature.
_STAKES = ("value", "value_per_m", "persons", "traffic_per_day")


@dataclass(frozen=True, slots=True)
class Readiness:
    """Whether a configuration is complete for a command."""

    task: str  # "run", "zone", "risk" (part of a zoning) or "profile"
    missing: tuple[str, ...]  # keys that are needed and not there
    problem: str = ""  # what else is in the way; empty if nothing

    @property
    def line(self) -> str:
        """One line for people."""
        if self.problem:
            return f"not ready for  {self.task}: {self.problem}"
        if not self.missing:
            return f"ready for      {self.task}"
        return f"not ready for  {self.task}: missing {'; '.join(self.missing)}"


def readiness(config: Config) -> tuple[Readiness, ...]:
    """What a configuration is complete for; no file is opened.

    That is run, zone, risk and, if the configuration has a profile, profile.
    """
    run = [] if config.terrain.dem is not None else ["terrain.dem"]
    run += [] if config.release.file is not None else ["release.file"]
    zone = list(run)
    if config.hazard.frequencies is None:
        zone += [
            f"blocks[{name}].onset_frequency (or hazard.frequencies)"
            for name, onset in config.onsets.items()
            if onset.frequency is None
        ]
    zone += [] if config.hazard.ref_width_m is not None else ["hazard.ref_width_m"]
    harm = [] if config.risk.vulnerability is not None else ["risk.vulnerability"]
    # A zoning with objects computes their risk, and stops where it cannot.
    risk = [*zone, *harm]
    if config.objects:
        zone += harm
    else:
        risk.append("[[objects]]")
    risk += [
        f"objects[{o.name}].value, persons or traffic_per_day"
        for o in config.objects
        if not any(getattr(o, k) or getattr(o, f"{k}_field") for k in _STAKES)
    ]
    found = {"run": run, "zone": zone, "risk": risk}
    if config.profile is not None:
        given = config.profile.file is not None or config.terrain.dem is not None
        found["profile"] = [] if given else ["profile.file (or --csv)"]
    return tuple(Readiness(task, tuple(missing)) for task, missing in found.items())
