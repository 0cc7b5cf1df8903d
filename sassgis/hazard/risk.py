"""Risk of exposed objects: hits per year by intensity, losses, deaths, and what each source adds.

Everything is linear in the hits: with h the annual hits of an object by intensity class i and
source s, every quantity is q = Σ_s Σ_i h[s, i] · c[s, i], where c is what one hit of the class by a
block of the source costs. The object risk and the risk to persons follow the usual product of
frequency, presence, vulnerability and value (Fell, Ho, Lacasse and Leroi, 2005, A framework for
landslide risk assessment and management; in Switzerland PLANAT and EconoMe), the vehicles on a road
Hungr, Evans and Hazzard (1999, Canadian Geotechnical Journal 36: 224-238), with the width of the
block added to the length of the vehicle. The formulas are not checked line
by line against these publications.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sassgis.grid import FloatArray
from sassgis.hazard.curves import at_energies, hazard_curves
from sassgis.settings.exposure import VEHICLE, ExposedObject, Vulnerability
from sassgis.settings.hazard_rules import Source, SourceCounts
from sassgis.simulation.map_sums import gamma_interval, pooled_freedom

#: What is stated of each object, all per year, besides the hits of each class; see RiskTable.
QUANTITIES = (
    "hits",
    "property_loss",
    "vehicle_loss",
    "loss",
    "vehicles_hit",
    "deaths",
    "individual_risk",
)
#: Those that can be added up over objects: the individual risks of different people cannot.
ADDITIVE = tuple(q for q in QUANTITIES if q != "individual_risk")

_HOURS_PER_DAY = 24.0
_METRES_PER_KM = 1000.0


@dataclass(frozen=True, slots=True)
class RiskTable:
    """Risk of each object from each source.

    Attributes
    ----------
    intensities : tuple of str
        Codes of the intensity classes, from weak to strong.
    hits : float64, shape (n_sources, n_objects, n_intensities)
        Blocks per year whose largest energy on the object is of the class.
    values : mapping of str to float64, shape (n_sources, n_objects)
        ``hits_<code>`` of each class (1/year), and the QUANTITIES: ``hits`` (1/year),
        ``property_loss`` of the object itself, ``vehicle_loss`` and their sum ``loss``
        (currency/year), ``vehicles_hit`` (1/year), ``deaths`` (1/year, the collective risk) and
        ``individual_risk`` (1/year, of one person of those there, or of the one road user of the
        traffic).
    variances : mapping of str to float64, shape (n_sources, n_objects)
        Upper bound of the sampling variance of each.
    """

    objects: tuple[ExposedObject, ...]
    sources: tuple[Source, ...]
    intensities: tuple[str, ...]
    hits: FloatArray
    values: Mapping[str, FloatArray]
    variances: Mapping[str, FloatArray]

    def of_object(self, quantity: str) -> FloatArray:
        """Sum over the sources, shape (n_objects,), correctly rounded whatever their order."""
        return _sums(self.values[quantity].T)

    def standard_error(self, quantity: str) -> FloatArray:
        """Return the upper bound of the standard error of :meth:`of_object`."""
        error: FloatArray = np.sqrt(_sums(by_sample(self.variances[quantity], self.sources).T))
        return error

    def limits(self, quantity: str) -> tuple[FloatArray, FloatArray]:
        """Return limits of a 95 % interval of :meth:`of_object`, given the sample.

        By map_sums.gamma_interval, with the variance over the value as what one more of what was
        drawn would add.
        """
        value = self.of_object(quantity)
        own = by_sample(self.variances[quantity], self.sources)
        variance = _sums(own.T)
        of_one = np.divide(variance, value, out=np.zeros_like(value), where=value > 0.0)
        keys = _samples(self.sources)
        of_sample = {key: s.freedom for key, s in zip(keys, self.sources, strict=True)}
        freedom = pooled_freedom(own, [of_sample[key] for key in sorted(of_sample)])
        return gamma_interval(value, variance, of_one, 0.95, freedom)

    @property
    def one_rock(self) -> FloatArray:
        """Return the hits per year of the block that counts most at each object; 0 without hits."""
        rates = np.array([s.rate_of_a_rock for s in self.sources])[:, None]
        reached = np.where(self.values["hits"] > 0.0, rates, 0.0)
        return np.asarray(reached.max(axis=0, initial=0.0), np.float64)


def _sums(rows: FloatArray) -> FloatArray:
    """Return correctly rounded sum of each row."""
    return np.array([math.fsum(row) for row in rows.tolist()], np.float64)


def _samples(sources: Sequence[Source]) -> list[tuple[str, str]]:
    """Return the sample of each source; scenarios of an area share its drawn points."""
    return [(s.area, "" if s.random_points else s.scenario) for s in sources]


def by_sample(variance: FloatArray, sources: Sequence[Source]) -> FloatArray:
    """Return variances of independent samples from those of sources, shape (n_sources, n).

    Every source is a separate sample, but scenarios of an area with random release points start
    from the same points: their standard errors add up at most.
    """
    keys = _samples(sources)
    number = {key: i for i, key in enumerate(sorted(set(keys)))}
    of_source = [number[key] for key in keys]
    error = np.zeros((len(number), variance.shape[1]))
    np.add.at(error, of_source, np.sqrt(variance))
    # A single source keeps its variance to the last bit.
    alone = np.bincount(of_source, minlength=len(number)) == 1
    out: FloatArray = error**2
    for source, sample in enumerate(of_source):
        if alone[sample]:
            out[sample] = variance[source]
    return out


# ---------------------------------------------------------------------------------------------
# One formula each


def vehicles_in_strip(
    vehicles_per_day: ArrayLike,
    speed_kmh: ArrayLike,
    vehicle_length_m: ArrayLike,
    block_width_m: ArrayLike,
) -> FloatArray:
    """Compute the expected number of vehicles that a block crossing the road meets.

    n = Q / (24 h/day) · (L + w) / (1000 m/km · v): vehicles per hour times the hours for which one
    of them has a part of itself in a strip as wide as the block, which crosses in no time. What
    drives into it after it has come to rest is not counted. The traffic Q is that of both
    directions. The mean number may exceed 1.
    """
    length = np.asarray(vehicle_length_m, np.float64) + np.asarray(block_width_m, np.float64)
    hours = length / (_METRES_PER_KM * np.asarray(speed_kmh, np.float64))
    met: FloatArray = np.asarray(vehicles_per_day, np.float64) / _HOURS_PER_DAY * hours
    return met


def class_hits(rate: FloatArray) -> FloatArray:
    """Return hits per year of each class: h_i = λ(E >= e_i) − λ(E >= e_{i+1}), the last open.

    ``rate`` is λ at the lower limits of the classes (1/year), shape (..., n_intensities).
    """
    hits: FloatArray = rate - np.concatenate([rate[..., 1:], np.zeros_like(rate[..., :1])], axis=-1)
    return hits


def weighted_variance(
    cost: FloatArray, rate: FloatArray, variance: FloatArray, source: Source
) -> FloatArray:
    """Return the upper bound of the sampling variance of Σ_i h_i c_i for one source.

    The classes' counts are nested (a block of a strong class is among those of the weak ones), so
    that their errors are correlated, while the sample keeps only the squares of each count, not
    their products. With w_i = c_i − c_{i−1} the quantity is Σ_i w_i λ_i.

    *Release points on a lattice* (strata of n blocks). The variance of a stratum is n times the
    variance of what one block costs, n/(n−1) (Σ y² − (Σ y)²/n), and for costs y >= 0 no more than
    Σ y²: in all f/N Σ_i h_i c_i², as for independent rare hits, times the weight of the block that
    counts most. Also Cov(λ_i, λ_j) = Σ k_j (n −
    k_i)/(n−1) lies between 0 and Var λ_j for the stronger class j (k_j <= k_i), which bounds
    Σ_i Σ_j w_i w_j Cov(λ_i, λ_j). The smaller of the two is given.

    *Release points at random* (the line is the unit). Standard errors add up at most: σ <= Σ_i
    |w_i| σ(λ_i) and σ <= Σ_i c_i σ(h_i), with Var h_i <= Var λ_i − Var λ_{i+1} + 2 λ_{i+1} h_i /
    (L − 1) from k_i² >= (k_i − k_{i+1})² + k_{i+1}². The smaller of the two is given.

    Parameters
    ----------
    cost : float64, shape (n, n_intensities)
        c_i: what one hit costs; 0 or more.
    rate, variance : float64, shape (n, n_intensities)
        λ(E >= e_i) of this source (1/year) and its sampling variance (1/year²).

    Returns
    -------
    float64, shape (n,)
        NaN where the sample does not give it: random points with a single line.
    """
    hits = class_hits(rate)
    step = np.diff(cost, axis=-1, prepend=0.0)
    error = np.sqrt(variance)
    n = rate.shape[-1]
    if source.random_points:
        after = np.concatenate([rate[..., 1:], np.zeros_like(rate[..., :1])], axis=-1)
        products = 2.0 * after * hits / max(source.lines - 1, 1)
        own = np.maximum(class_hits(variance) + products, 0.0)
        nested = np.einsum("...i,...i->...", np.abs(step), error)
        apart = np.einsum("...i,...i->...", cost, np.sqrt(own))
        return np.asarray(np.minimum(nested, apart) ** 2, np.float64)
    rare = source.rate_of_a_rock * np.einsum("...i,...i->...", hits, cost**2)
    nested = np.einsum("...i,...i->...", step**2, variance)
    for i in range(n):
        for j in range(i + 1, n):
            together = np.minimum(variance[..., j], error[..., i] * error[..., j])
            nested = nested + 2.0 * np.maximum(step[..., i] * step[..., j], 0.0) * together
    # Lines of one block give no variance; the bound by the number of hits holds all the same.
    return np.asarray(np.fmin(rare, nested), np.float64)


def hit_costs(
    objects: Sequence[ExposedObject], vulnerability: Vulnerability, block_width_m: float
) -> dict[str, FloatArray]:
    """Compute what one hit of each intensity by a block of a width (m) costs each object.

    Returns
    -------
    dict of str to float64, shape (n_objects, n_intensities)
        As the values of a RiskTable. With vulnerability v, lethality l, stake S (value, or value
        per metre times the length destroyed), n vehicles in the strip:
        ``hits`` 1 · ``property_loss`` v S · ``vehicle_loss`` n v_vehicle value_vehicle ·
        ``vehicles_hit`` n · ``deaths`` persons · presence · l + n · persons_per_vehicle · l_vehicle
        · ``individual_risk`` presence · l, on roads n_one l_vehicle with the trips of one user in
        place of the traffic; ``hits_<code>`` 1 for its class.
    """
    shape = (len(objects), len(vulnerability.intensities))
    costs = {q: np.zeros(shape) for q in QUANTITIES}
    costs["hits"][:] = 1.0
    for code, one in zip(vulnerability.intensities, np.eye(shape[1]), strict=True):
        costs[f"hits_{code}"] = np.broadcast_to(one, shape)
    numbers = {
        kind: np.array([[r.vulnerability, r.lethality] for r in vulnerability.of(kind)]).T
        for kind in vulnerability.kinds
    }
    for k, thing in enumerate(objects):
        lost, lethal = numbers[thing.kind]
        costs["property_loss"][k] = lost * thing.stake(block_width_m)
        costs["deaths"][k] = thing.persons * thing.presence * lethal
        costs["individual_risk"][k] = thing.presence * lethal
        traffic = thing.traffic
        if traffic is None:
            continue
        lost, lethal = numbers[VEHICLE]
        met, one = vehicles_in_strip(
            [traffic.traffic_per_day, traffic.trips_per_day],
            traffic.speed_kmh,
            traffic.vehicle_length_m,
            block_width_m,
        )
        costs["vehicles_hit"][k] = met
        costs["vehicle_loss"][k] = met * traffic.vehicle_value * lost
        costs["deaths"][k] = met * traffic.persons_per_vehicle * lethal
        costs["individual_risk"][k] = one * lethal
    costs["loss"] = costs["property_loss"] + costs["vehicle_loss"]
    return costs


# ---------------------------------------------------------------------------------------------
# The table


def assess_risk(
    objects: Sequence[ExposedObject],
    sources: Sequence[Source],
    counts: Sequence[SourceCounts],
    energies_kj: ArrayLike,
    limits_kj: Sequence[float],
    vulnerability: Vulnerability,
) -> RiskTable:
    """Compute the risk of each object from each source; places of counts are numbers of objects.

    ``energies_kj`` are those of the columns of the counts, ``limits_kj`` the lower limits of the
    intensity classes of the vulnerability table, all of them among the energies.

    Raises
    ------
    InputError
        If the vulnerability table has no rows for a kind of object.
    ValueError
        If a limit is none of the energies, or the counts name no object.
    """
    vulnerability.check_covers(objects)
    if len(limits_kj) != len(vulnerability.intensities):
        raise ValueError("the classes of intensity are not those of the vulnerability table")
    shape = (len(sources), len(objects), len(limits_kj))
    rate, variance = np.zeros(shape), np.zeros(shape)
    for s, (source, own) in enumerate(zip(sources, counts, strict=True)):
        curves = at_energies(hazard_curves([source], [own], energies_kj), limits_kj)
        if not np.isin(curves.places, np.arange(len(objects))).all():
            raise ValueError("counts of a place that is no object")
        rate[s, curves.places], variance[s, curves.places] = curves.rate, curves.variance
    hits = class_hits(rate)
    names = (*(f"hits_{code}" for code in vulnerability.intensities), *QUANTITIES)
    values, variances = ({q: np.zeros(shape[:2]) for q in names} for _ in range(2))
    for s, source in enumerate(sources):
        for q, cost in hit_costs(objects, vulnerability, source.block_width_m).items():
            values[q][s] = _sums(hits[s] * cost)
            variances[q][s] = weighted_variance(cost, rate[s], variance[s], source)
    return RiskTable(
        tuple(objects), tuple(sources), vulnerability.intensities, hits, values, variances
    )


# ---------------------------------------------------------------------------------------------
# Rows of tables


def total_rows(table: RiskTable) -> list[dict[str, Any]]:
    """Return a row per sum: by road or line ("whole"), by kind, by source, and over all.

    Each value of the ADDITIVE quantities is the correctly rounded sum (``math.fsum``) of those of
    its objects, as ``RiskTable.of_object`` returns them; for a source, of what it adds to each
    object. Standard errors are upper bounds: as if each source's blocks hit all objects or none,
    and, with ``_apart``, if no block hits two of the objects. The largest individual risk is NaN
    for a source.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for i, thing in enumerate(table.objects):
        if thing.parent:
            groups.setdefault(("whole", thing.parent), []).append(i)
    for i, thing in enumerate(table.objects):
        groups.setdefault(("kind", thing.kind), []).append(i)
    rows = [_total_row(table, scope, name, own) for (scope, name), own in groups.items()]
    everything = list(range(len(table.objects)))
    for s, source in enumerate(table.sources):
        rows.append(_total_row(table, "source", source.label, everything, s))
    return [*rows, _total_row(table, "all", "all objects", everything)]


def _total_row(
    table: RiskTable, scope: str, name: str, own: list[int], source: int | None = None
) -> dict[str, Any]:
    chosen = slice(None) if source is None else slice(source, source + 1)
    row: dict[str, Any] = {"scope": scope, "name": name, "objects": len(own)}
    for q in ADDITIVE:
        values = table.of_object(q) if source is None else table.values[q][source]
        variance = by_sample(table.variances[q][chosen][:, own], table.sources[chosen])
        most = (np.sqrt(variance).sum(axis=1) ** 2).tolist()
        row[f"{q}_per_year"] = math.fsum(values[own].tolist())
        row[f"{q}_per_year_se"] = math.sqrt(math.fsum(most))
        row[f"{q}_per_year_se_apart"] = math.sqrt(math.fsum(variance.ravel().tolist()))
    individual = math.nan if source is not None else _largest_individual(table, own)
    return row | {"individual_risk_largest_per_year": individual}


def _largest_individual(table: RiskTable, own: Iterable[int]) -> float:
    """Find the largest risk of one person; a driver passes all stretches of a road."""
    risks = table.of_object("individual_risk")
    wholes: dict[str, list[float]] = {}
    for i in own:
        wholes.setdefault(table.objects[i].whole, []).append(float(risks[i]))
    return max((math.fsum(parts) for parts in wholes.values()), default=math.nan)


def _who(thing: ExposedObject) -> dict[str, object]:
    return {"name": thing.name, "kind": thing.kind, "part_of": thing.parent}


def _share(part: float, whole: float) -> float:
    """Return the part over the whole; NaN where the whole is 0."""
    return float(part / whole) if whole else math.nan


def object_rows(table: RiskTable) -> list[dict[str, object]]:
    """Return a row per object: its kind, and every quantity with its standard error."""
    sums = {q: table.of_object(q) for q in table.values}
    errors = {q: table.standard_error(q) for q in table.values}
    one_rock = table.one_rock
    rows: list[dict[str, object]] = []
    for k, thing in enumerate(table.objects):
        stated = ("from_m", "length_m", "value", "value_per_m", "persons", "presence")
        row = _who(thing) | {name: getattr(thing, name) for name in stated}
        row["traffic_per_day"] = thing.traffic.traffic_per_day if thing.traffic else 0.0
        for q in table.values:
            row[f"{q}_per_year"] = float(sums[q][k])
            row[f"{q}_per_year_se"] = float(errors[q][k])
        row["hits_of_one_rock_per_year"] = float(one_rock[k])
        rows.append(row)
    return rows


def source_rows(table: RiskTable) -> list[dict[str, object]]:
    """Return a row per object and source that hits it: what that adds, and its share."""
    loss, deaths = table.of_object("loss"), table.of_object("deaths")
    rows: list[dict[str, object]] = []
    for k, thing in enumerate(table.objects):
        for s, source in enumerate(table.sources):
            if not table.values["hits"][s, k]:
                continue
            row = _who(thing) | {"area": source.area, "scenario": source.scenario}
            for i, code in enumerate(table.intensities):
                row[f"hits_{code}_per_year"] = float(table.hits[s, k, i])
            for q in QUANTITIES:
                row[f"{q}_per_year"] = float(table.values[q][s, k])
                row[f"{q}_per_year_se"] = math.sqrt(table.variances[q][s, k])
            row["share_of_loss"] = _share(table.values["loss"][s, k], loss[k])
            row["share_of_deaths"] = _share(table.values["deaths"][s, k], deaths[k])
            rows.append(row)
    return rows
