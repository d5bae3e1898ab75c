# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Study of a simulation against flights: the effects it lacks, where they show, how it then flies."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType

import numpy as np
from scipy.special import ndtri

from quadpi_core import array_checks
from quadpi_core.discrepancy.acceptance import (
    ALLOWED,
    CLOSES_NOTHING,
    FEW_FLIGHTS,
    HOLDS_MORE,
    NO_EXPLANATION,
    Accepted,
    Verdict,
)
from quadpi_core.discrepancy.augmented_simulation import augmented
from quadpi_core.discrepancy.by_condition import locate
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.closure import Closing, Gap, SearchResult
from quadpi_core.discrepancy.discrepancy_result import (
    Discovery,
    FlightCondition,
    FoundEffect,
    FoundParameter,
    OfFlight,
    Study,
    commanded_speeds,
    traces,
)
from quadpi_core.discrepancy.effect_response import Compared, at_scale_of
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.reflight import HORIZON_S, coverages, reflights
from quadpi_core.discrepancy.result_verdicts import (
    CLOSED,
    NEAR_FLOOR,
    OF_GAP,
    Unexplained,
    checks,
    is_rejected,
    judge_not_zero,
    judged_by_rollouts,
    ranked_candidates,
    with_stated_coefficients,
)
from quadpi_core.discrepancy.search import MOST_EFFECTS, Prepared, search
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, Flight
from quadpi_core.flight_files import FlightFile, LeftOutFlights, for_each_flight, once_each
from quadpi_core.identification.commanded_flights import read_with_motors
from quadpi_core.identification.prepared_flights import read_flight
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.parallel import DEFAULT_WORKERS, Workers, one_blas_thread
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.screening.rotors_in_flight import require_changes, require_excitation
from quadpi_core.vehicle import Motors, Vehicle

FEWEST_FLIGHTS = Threshold(
    "fewest flights", 2, "flights", "what is found on some flights is tested on others", CONVENTION
)
UNSEEN = Threshold(
    "samples of an axis that intervals lose without one of several effects",
    0.02,
    "of the samples",
    "a change that pushes fewer out is not visible, by the benchmark of real flights",
    CONVENTION,
)
# Vehicle, motors of single flights by path, cut-off, how to read.
_Task = tuple[Vehicle, Mapping[str, Motors], float, MappingOrOptions]
_log = logging.getLogger(__name__)
_LOAD_SIMULATION = "load_simulation(text) reads one"
# Steady forces that thrust has in a frame that is turned about x or y.
_LATERAL = ("x_n", "y_n")
# Probability that a stated interval of a parameter holds it.
_CONFIDENCE = 0.95


def read_flights(
    paths: Path | str | Iterable[Path | str],
    simulation: Simulation,
    *,
    mapping: MappingOrOptions = None,
    workers: Workers = DEFAULT_WORKERS,
    left_out: LeftOutFlights = None,
    from_commands: bool = False,
) -> list[Flight]:
    """Read flights of the simulation's vehicle: fused, low-passed at the default of models, in the air.

    Where a flight has motor commands and no rotor speeds, those of all flights are made of commands: by the
    motors of the simulation's vehicle file or model, else by those that the other flights tell.

    Args:
        paths: bags or logs.
        simulation: simulation of the vehicle that flew.
        mapping: see :func:`quadpi_core.logs.read_recording`.
        workers: processes that read the files.
        left_out: list to which flights that cannot be used are added; without it, the first is an error.
        from_commands: make rotor speeds of commands even where all flights have them measured.

    Raises:
        ArgumentError: for what are no paths, simulation or workers.
        LogError: for what cannot be read or used, another vehicle, and a flight present twice.
        SignalError: naming the file, where the signals cannot be fused.
        DiscrepancyError: for too few flights, one shorter than a roll-out, and constant rotor speeds.
        ParallelError: see :meth:`quadpi_core.parallel.Workers.map`.
    """
    files = array_checks.paths("paths", paths)
    array_checks.instance("simulation", simulation, Simulation, _LOAD_SIMULATION)
    array_checks.instance("workers", workers, Workers)
    require_flights(len(files))

    def read(vehicle: Vehicle, left_out: LeftOutFlights, motors: Mapping[str, Motors]) -> list[Flight]:
        task: _Task = (vehicle, motors, CUTOFF_HZ["default"], workers.found_by(mapping))
        each = for_each_flight(
            _read, files, shared=task, task="Reading flights", workers=workers, left_out=left_out
        )
        return [flight for _, flight in once_each(each, attrgetter("sha256"), left_out)]

    known = simulation.vehicle
    flights, _, said = read_with_motors(
        *(read, files, known),
        mapping=mapping,
        workers=workers,
        left_out=left_out,
        commands=from_commands and known.motors is None,
    )
    if said:
        _log.warning("%s", said)
    require_flights(len(flights))
    return flights


def _read(task: _Task, file: FlightFile) -> Flight:
    vehicle, motors, cutoff_hz, mapping = task
    vehicle = replace(vehicle, motors=motors.get(str(file.path), vehicle.motors))
    flight = read_flight(file.path, vehicle, cutoff_hz, mapping)
    return study_flight(replace(flight, name=file.name), file.path)


def study_flight(flight: Flight, source: Path | str = "") -> Flight:
    """The part of a flight that a study takes, for a flight that is long enough.

    Args:
        flight: fused, low-passed at the default of models, in the air.
        source: of the flight in refusals; its own unless given.

    Raises:
        DiscrepancyError: for a flight shorter than a roll-out, and constant rotor speeds.
    """
    flight = flight.longest_stretch()
    length_s = float(flight.time[-1] - flight.time[0])
    if length_s <= HORIZON_S:
        raise DiscrepancyError(
            f"{source or flight.source}: {length_s:.2g} s in the air, "
            f"shorter than the {HORIZON_S:g} s of a roll-out"
        )
    require_changes(flight)
    return flight


def study(
    simulation: Simulation, flights: Sequence[Flight], *, names: Sequence[str] | None = None, seed: int = 0
) -> Study:
    """Find the effects that a simulation lacks, and where they show.

    Args:
        simulation: simulation to compare with.
        flights: see :func:`read_flights`.
        names: names of effects to look for; unless given, all.
        seed: seed of all draws.

    Raises:
        ArgumentError: for what are no simulation, flights, names or seed.
        LogError: for samples of a flight that are not finite.
        DiscrepancyError: see :func:`discover`; for flights of hover alone, and rotor
            speeds that do not change.
    """
    array_checks.instance("simulation", simulation, Simulation, _LOAD_SIMULATION)
    flights = array_checks.several("flights", flights, Flight, "read_flights(paths, simulation) gives them")
    names = None if names is None else array_checks.several("names", names, str)
    seed = array_checks.whole("seed", seed, 0, 2**32)
    require_flights(len(flights))
    for flight in flights:
        flight.require_finite()
    missing = require_excitation(flights, simulation.vehicle)
    discovery = found_and_flown(simulation, flights, names=names)
    return Study(
        simulation=simulation,
        flights=tuple(flights),
        discovery=discovery,
        where=locate(discovery.found, seed),
        not_flown=missing,
        seed=seed,
    )


def found_and_flown(
    simulation: Simulation, flights: Sequence[Flight], *, names: Sequence[str] | None = None
) -> Discovery:
    """Find the effects that a simulation lacks, and judge them by roll-outs of flights left out.

    An effect that closes nothing of the gap, or explains what the simulation's own intervals allow for, is no
    explanation, and is barred from another search. So is one of several without which these hold as much, of
    what is faster than a search compares, too. At last one is barred without which the result holds. It takes
    what :func:`prepared` does.

    Raises:
        DiscrepancyError, LogError: see :func:`prepared`; for a bag whose plan cannot be read.
    """
    # Products are so small that two threads take twice the time of one.
    with one_blas_thread():
        discovery = flown_again(_searched_again(prepared(simulation, flights, names), {}))
        return replace(discovery, candidates=ranked_candidates(discovery.found))


def _searched_again(ready: Prepared, barred: Mapping[str, str]) -> Discovery:
    """What a search finds, or another without what explains nothing or does not hold.

    It is flown again where that may decide anything: not beside a test that no flight changes.
    """
    discovery = discovered(ready, barred)
    more = _explaining_nothing(discovery)
    hopeless = any(not check.passed and check.test not in OF_GAP for check in discovery.checks)
    if not (more or hopeless):
        discovery = flown_again(discovery)
        more = _spoiling(discovery)
    if more:
        again = _searched_again(ready, {**barred, **more})
        if again.verdict != "unknown":
            return again
    if not hopeless or len(discovery.effects) == 1:
        discovery = flown_again(discovery)
    doubtful = {} if more or len(barred) >= MOST_EFFECTS.value else _doubtful(discovery)
    if doubtful:
        without = _searched_again(ready, {**barred, **doubtful})
        if without.verdict == "effects":
            return without
    for name, reason in more.items():
        if reason in NO_EXPLANATION and discovery.verdict == "effects":
            sentence = f"{name} {reason}, and no other search explains the flights"
            check = Verdict.by_limit(NEAR_FLOOR, "closes", 0.0, False, sentence)
            discovery = replace(discovery, checks=(*discovery.checks, check))
    return discovery


def _explaining_nothing(discovery: Discovery) -> dict[str, str]:
    """Which effect explains the least, and why that is nothing; empty otherwise.

    Coefficients stay as stated: within wide tolerances they could close what an effect does. So one that
    intervals allow for explains something all the same where the gap of the axes that they do not hold is
    closed with it, and open without. One alone is not doubted where the gap counts as closed, and none on so
    few flights that they do not predict each other.
    """
    found = discovery.found

    def stated(chosen: tuple[int, ...]) -> Gap:
        return replace(found, closing=Closing.from_regression(found.regression, chosen)).gap(adjusted=False)

    whole = stated(found.chosen)
    without = {own: stated(tuple(k for k in found.chosen if k != own)) for own in found.chosen}
    names = {own: found.regression.candidates[own].name for own in found.chosen}
    for own in sorted(found.allowed, key=lambda index: found.allowed[index]):
        if not without[own].reduction < CLOSED.value <= whole.reduction:
            return {names[own]: ALLOWED}
    closed = all(check.passed for check in discovery.checks if check.test == "closed")
    few = len(found.regression.flights) < FEW_FLIGHTS.value
    if few or not found.chosen or (len(found.chosen) == 1 and closed):
        return {}
    squares = np.square(whole.after), np.square(whole.floor)
    opened = [
        (float(np.max((np.square(gap.after) - squares[0]) / squares[1])), names[own])
        for own, gap in without.items()
    ]
    most, name = min(opened)
    return {} if most > NEAR_FLOOR.value else {name: CLOSES_NOTHING}


def _doubtful(discovery: Discovery) -> dict[str, str]:
    """The effect that a result which does not hold may hold without, and what speaks against it; or empty.

    It is one whose every parameter may be zero, else the one that gains least beside the others. One alone is
    left out for another that does about as well, where flights left out get worse with it.
    """
    found, failed = discovery.found, [check for check in discovery.checks if not check.passed]
    another = is_rejected(discovery) and any(found.rivals.values())
    if not failed or not (len(found.chosen) > 1 or another):
        return {}
    gains = Accepted(found.regression, found.chosen, found.fit).gains()
    effects = dict(zip(found.chosen, discovery.effects, strict=True))
    least = min(effects, key=lambda index: (judge_not_zero(effects[index]).passed, gains[index]))
    return {effects[least].name: failed[0].sentence}


def _spoiling(discovery: Discovery) -> dict[str, str]:
    """What flights have of their own without which intervals hold more, else an effect of several, as much.

    Empty where there is none, or a test but theirs fails.
    """
    regression, flown = discovery.found.regression, discovery.flown
    against = any(not check.passed and check.test != "coverage" for check in discovery.checks)
    named = [effect.name for effect in discovery.effects]
    own = sorted({regression.candidates[one.index].name for one in regression.conditions} - {*named})
    tried = own + named * (len(named) > 1)
    if flown is None or not flown.coverage or against or not tried:
        return {}
    after = [augmented(discovery, without=place) for place in range(len(regression.flights))]
    lost = {}
    for name in tried:
        others = [{own: values for own, values in one.effects.items() if own != name} for one in after]
        fewer = [replace(one, effects=effects) for one, effects in zip(after, others, strict=True)]
        held = coverages(regression.flights, fewer)
        lost[name] = [own.after - held[axis].after for axis, own in flown.coverage.items()]
    idle = sorted((max(lost[name]), name) for name in tried if max(lost[name]) <= UNSEEN.value)
    more = min(((min(lost[name]), name) for _, name in idle if name in own), default=(0.0, ""))
    if more[0] < -UNSEEN.value:
        return {more[1]: HOLDS_MORE}
    return next(({name: "intervals hold as much without it"} for _, name in idle if name in named), {})


def flown_again(discovery: Discovery) -> Discovery:
    """The discovery judged by roll-outs of flights left out; as it is where it was, or nothing is named.

    Coefficients stay as stated, if roll-outs do better so: small errors of moments accumulate over 0.5 s.
    """
    if discovery.flown or not discovery.effects:
        return discovery
    judged = judged_by_rollouts(discovery, reflights(discovery))
    if not is_rejected(judged) or not discovery.found.closing.adjusted:
        return judged
    stated = with_stated_coefficients(discovery)
    without = judged_by_rollouts(stated, reflights(stated))
    return judged if is_rejected(without) else without


def discover(
    simulation: Simulation,
    flights: Sequence[Flight],
    *,
    names: Sequence[str] | None = None,
    barred: Mapping[str, str] = MappingProxyType({}),
) -> Discovery:
    """Find the effects that explain where a simulation and flights disagree, see :func:`prepared`."""
    with one_blas_thread():
        discovery = discovered(prepared(simulation, flights, names), barred)
        return replace(discovery, candidates=ranked_candidates(discovery.found))


def prepared(
    simulation: Simulation, flights: Sequence[Flight], names: Sequence[str] | None = None
) -> Prepared:
    """Flights ready to be searched.

    Args:
        simulation: simulation to compare with.
        flights: at least two flights of the simulation's vehicle, fused and in the air.
        names: names of effects to look for; unless given, all.

    Raises:
        DiscrepancyError: for fewer flights, flights of another vehicle, a simulation that gives no wrench.
    """
    require_flights(len(flights))
    for flight in flights:
        if flight.vehicle and flight.vehicle != simulation.vehicle.name:
            raise DiscrepancyError(
                f"{flight.source}: flown by vehicle {flight.vehicle}, "
                f"but the simulation {simulation.name} is of {simulation.vehicle.name}"
            )
    compared = Compared.together(at_scale_of(simulation, flights), simulation)
    return Prepared.from_flights(compared, candidates(simulation.vehicle, names))


def discovered(ready: Prepared, barred: Mapping[str, str]) -> Discovery:
    """What a search of flights names, judged as a whole; candidates are not ranked."""
    found = search(ready, barred)
    law, whole = found.closing.fits()
    effects = [_effect(found, index, law, whole) for index in found.chosen]
    left, gap = Unexplained.from_search(found), found.gap()
    judged = checks(found, effects, left, gap)
    against = not all(check.passed for check in judged)
    return Discovery(
        effects=tuple(effects),
        unexplained=left.share,
        unexplained_by={
            axis: found.left.functions[i]
            for i, axis in enumerate(AXES)
            # In a doubtful case, every axis that other flights predict at all is a hint.
            if left.squares[i] or (against and found.left.gain[i] > 0.0)
        },
        gap=gap,
        found=found,
        checks=judged,
        without_trace=_without_trace(found),
        within_intervals=tuple(sorted(ready.within)),
        conditions=tuple(_conditions(found)),
        commanded=commanded_speeds(found),
    )


def _conditions(found: SearchResult) -> Iterator[FlightCondition]:
    """What single flights have of their own, of parameters in which any stands out."""
    regression = found.regression
    vehicle = regression.flights[0].simulation.vehicle
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    for condition in regression.conditions:
        candidate = regression.candidates[condition.index]
        each = {
            flight.flight.name: regression.of_condition(condition, place, found.fit)
            for place, flight in enumerate(regression.flights)
        }
        for k, free in enumerate(candidate.free):
            own = {name: OfFlight(float(m[k]), float(d[k])) for name, (m, d) in each.items()}
            if any(one.stands_out for one in own.values()):
                parameter = candidate.effect.parameters[free]
                share = max(abs(one.value) for one in own.values()) / weight
                cause = likely_cause(candidate.of_a_flight, parameter.name, share)
                yield FlightCondition(candidate.label, parameter.name, parameter.unit, cause, own)


def likely_cause(cause: str, parameter: str, share: float) -> str:
    """The cause of a condition, with what turned markers show alike: a share of the thrust to the side."""
    if parameter not in _LATERAL:
        return cause
    return f"{cause}, or markers turned by {np.degrees(np.arctan(share)):.1f}°"


def _without_trace(found: SearchResult) -> tuple[str, ...]:
    """Effects that could not gain the least evidence here, even as large as the prior expects.

    So it is with wind beside a simulation of thrust alone, which is the same in any wind, and with the ground
    where no flight comes near it.
    """
    energies = traces(found.regression, found.regression.noise)
    return tuple(name for name, energy in energies.items() if energy < found.threshold)


def require_flights(count: int) -> None:
    """Refuse fewer flights than a search needs, with a DiscrepancyError."""
    if count < FEWEST_FLIGHTS.value:
        raise DiscrepancyError(
            f"{count} flight: what is found on some flights is tested on others; "
            f"{FEWEST_FLIGHTS.value} are the least"
        )


def _effect(found: SearchResult, index: int, law: Fit, whole: Fit) -> FoundEffect:
    regression, candidate = found.regression, found.regression.candidates[index]
    values = candidate.values(regression.parameters(index, law))
    half = np.zeros(len(values))
    half[list(candidate.free)] = float(ndtri(0.5 + 0.5 * _CONFIDENCE)) * found.deviation(index)
    rivals = found.rivals[index]
    odds = sum(against for _, against in rivals)
    names = tuple(dict.fromkeys(regression.candidates[rival].name for rival, _ in rivals))
    manoeuvres = (candidate.effect.shown_by, *(regression.candidates[r].effect.shown_by for r, _ in rivals))
    return FoundEffect(
        name=candidate.name,
        probability=float(1.0 / (1.0 + odds)),
        parameters=tuple(
            FoundParameter(p.name, p.unit, float(v), float(v - h), float(v + h))
            for p, v, h in zip(candidate.effect.parameters, values, half, strict=True)
        ),
        shape=found.closing.shape(index, law, whole),
        axes=candidate.effect.axes,
        rivals=names,
        shown_by=tuple(dict.fromkeys(manoeuvres)),
    )
