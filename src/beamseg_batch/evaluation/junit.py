"""Checks as JUnit XML, the format in which build servers read tests."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from beamseg_batch.evaluation.gates import Check
from beamseg_batch.evaluation.measures import Metrics

__all__ = ["junit_xml"]


def junit_xml(suite: str, checks: Sequence[Check], metrics: Metrics) -> str:
    """Write checks as one test suite.

    Parameters
    ----------
    suite : str
        Its name.
    checks : sequence of Check
        A test case each. Without any there is one that passed, since servers take a suite
        without tests for a mistake.
    metrics : Metrics
        Properties of the suite; those without a value are left out.

    Returns
    -------
    str
        XML, ended by a line feed.
    """
    cases = checks or (Check("measured", True, "no condition was given"),)
    failures = sum(not check.passed for check in cases)
    counts = {"tests": str(len(cases)), "failures": str(failures), "errors": "0", "skipped": "0"}
    root = ElementTree.Element("testsuites", counts)
    element = ElementTree.SubElement(root, "testsuite", {"name": _printable(suite), **counts})
    properties = ElementTree.SubElement(element, "properties")
    for name, value in metrics.items():
        if value is not None:
            ElementTree.SubElement(properties, "property", name=name, value=repr(value))
    for check in cases:
        case = ElementTree.SubElement(
            element, "testcase", classname="beamseg", name=_printable(check.name), time="0"
        )
        text = _printable(f"{check.name}: {check.found}")
        if check.passed:
            ElementTree.SubElement(case, "system-out").text = text
        else:
            ElementTree.SubElement(case, "failure", message=text).text = text
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'


def _printable(text: str) -> str:
    """Text that XML and UTF-8 can hold: the rest, as file names may have it, is escaped."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode("ascii")
        for char in text
    )
