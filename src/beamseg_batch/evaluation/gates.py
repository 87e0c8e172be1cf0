"""Conditions on figures that a run must hold: ``axis_offset.median<=0.005``."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from beamseg_batch.errors import ConfigError
from beamseg_batch.evaluation.measures import Metrics
from beamseg_batch.schema import YamlError, nearest, read_yaml

__all__ = ["Check", "Gate", "check_gates", "load_gates"]

_OPERATORS: Mapping[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "<": operator.lt,
    ">": operator.gt,
}
_GATE = re.compile(r"\s*(?P<metric>[\w.]+)\s*(?P<sign><=|>=|==|<|>)\s*(?P<limit>[^\s<>=]+)\s*")


@dataclass(frozen=True)
class Gate:
    """A condition: `metric`, `sign` (``<= >= == < >``) and `limit`."""

    metric: str
    sign: str
    limit: float

    def __str__(self) -> str:
        return f"{self.metric} {self.sign} {self.limit:g}"


@dataclass(frozen=True)
class Check:
    """Something that had to hold: its `name`, whether it `passed`, and `found` in words."""

    name: str
    passed: bool
    found: str


def load_gates(texts: Iterable[str], metrics: Iterable[str]) -> tuple[Gate, ...]:
    """Read gates as they are given on the command line.

    Parameters
    ----------
    texts : iterable of str
        Each a gate, or ``@FILE`` with a YAML list of gates.
    metrics : iterable of str
        Names of all figures.

    Returns
    -------
    tuple of Gate

    Raises
    ------
    ConfigError
        If a file cannot be read, a text is no gate, or a metric is not known.
    """
    known = tuple(metrics)
    gates: list[Gate] = []
    for text in texts:
        lines = _gates_of_file(Path(text[1:])) if text.startswith("@") else [(text, "--require")]
        gates += [_parse(line, where, known) for line, where in lines]
    return tuple(gates)


def check_gates(gates: Sequence[Gate], metrics: Metrics) -> tuple[Check, ...]:
    """Hold figures against gates.

    Parameters
    ----------
    gates : sequence of Gate
    metrics : Metrics

    Returns
    -------
    tuple of Check
        One per gate. A figure that has no value, because there was nothing to measure,
        fails.
    """
    return tuple(_check(gate, metrics[gate.metric]) for gate in gates)


def _check(gate: Gate, value: float | None) -> Check:
    if value is None:
        return Check(str(gate), False, "has no value: there was nothing to measure")
    return Check(str(gate), _OPERATORS[gate.sign](value, gate.limit), f"is {value:.6g}")


def _gates_of_file(path: Path) -> list[tuple[str, str]]:
    """Gates of a YAML list, each with the place that an error names."""
    try:
        content, node = read_yaml(path)
    except YamlError as error:
        where = path if error.line is None else f"{path}:{error.line}"
        raise ConfigError(f"{where}: {error}") from error
    if not isinstance(content, list) or not all(isinstance(line, str) for line in content):
        raise ConfigError(f"{path}: must be a list of gates, such as '- recall >= 0.99'")
    places = [f"{path}:{item.start_mark.line + 1}" for item in node.value]
    return list(zip(content, places, strict=True))


def _parse(text: str, where: str, known: Sequence[str]) -> Gate:
    parts = _GATE.fullmatch(text)
    if parts is None:
        raise ConfigError(
            f"{where}: {text!r} is not a gate; write METRIC SIGN NUMBER with a sign of "
            f"{' '.join(_OPERATORS)}, such as axis_offset.median<=0.005"
        )
    metric = parts["metric"]
    if metric not in known:
        hint = nearest(metric, known) or f"; there are: {', '.join(known)}"
        raise ConfigError(f"{where}: there is no metric {metric!r}{hint}")
    try:
        limit = float(parts["limit"])
    except ValueError:
        limit = math.nan
    if math.isnan(limit):
        raise ConfigError(f"{where}: {text!r}: the limit {parts['limit']!r} is not a number")
    return Gate(metric, parts["sign"], limit)
