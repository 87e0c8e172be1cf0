"""Checks for build servers."""

from __future__ import annotations

from xml.etree import ElementTree

from beamseg_batch.evaluation.gates import Check
from beamseg_batch.evaluation.junit import junit_xml

METRICS = {"recall": 0.1 + 0.2, "matched": 3, "precision": None}
CHECKS = (Check("recall >= 0.99", False, "is 0.3"), Check("matched == 3", True, "is 3"))


def parsed(*arguments):
    return ElementTree.fromstring(junit_xml(*arguments))


def test_junit_xml__a_case_per_check():
    root = parsed("evaluate out", CHECKS, METRICS)
    suite = root.find("testsuite")
    assert root.tag == "testsuites"
    assert suite.get("name") == "evaluate out"
    assert (suite.get("tests"), suite.get("failures"), root.get("failures")) == ("2", "1", "1")
    failed, passed = suite.findall("testcase")
    assert failed.get("name") == "recall >= 0.99"
    assert failed.find("failure").get("message") == "recall >= 0.99: is 0.3"
    assert passed.find("failure") is None


def test_junit_xml__figures_are_properties():
    properties = parsed("s", CHECKS, METRICS).iter("property")
    assert {p.get("name"): p.get("value") for p in properties} == {
        "recall": repr(0.1 + 0.2),
        "matched": "3",
    }


def test_junit_xml__no_condition_is_one_case_that_passed():
    suite = parsed("s", (), METRICS).find("testsuite")
    assert (suite.get("tests"), suite.get("failures")) == ("1", "0")
    assert suite.find("testcase").get("name") == "measured"


def test_junit_xml__names_that_xml_cannot_hold():
    suite = parsed('run \x00\udcff <&">', (Check("a\x1b", True, "]]>"),), {})
    assert suite.find("testsuite").get("name") == 'run \\x00\\udcff <&">'
    assert suite.find("testsuite/testcase").get("name") == "a\\x1b"
