"""Catalogues of standard sizes: the shipped one, and what is wrong with others."""

from __future__ import annotations

import pytest

from beamseg_batch.catalogue import load_catalogue
from beamseg_batch.config import load_config
from beamseg_batch.errors import ConfigError
from beamseg_batch.model import DepthNoise
from beamseg_batch.section import Section
from beamseg_batch.structure import EvidenceStructure

HEADER = "name,shape,width_mm,height_mm,web_mm,flange_mm\n"


def written(tmp_path, text):
    path = tmp_path / "sizes.csv"
    path.write_text(text)
    return path


def test_load_catalogue__shipped_one_holds_european_sizes():
    sizes = {entry.name: entry.section for entry in load_catalogue()}
    assert sizes["IPE 120"] == Section("i", 0.064, 0.12, 0.0044, 0.0063)
    assert sizes["HEB 100"] == Section("i", 0.1, 0.1, 0.006, 0.01)
    assert sizes["UPN 120"] == Section("c", 0.055, 0.12, 0.007, 0.009)
    assert sizes["L 100x65x8"] == Section("l", 0.065, 0.1, 0.008, 0.008)
    assert sizes["RHS 120x80"] == Section("square", 0.08, 0.12)
    assert len(sizes) == len(load_catalogue()) > 100


def test_load_catalogue__columns_in_any_order_beside_others(tmp_path):
    path = written(
        tmp_path,
        "mass,shape,name,height_mm,width_mm,flange_mm,web_mm\n9,i,My 1,100,50,6,4\n",
    )
    (entry,) = load_catalogue(path)
    assert entry.section == Section("i", 0.05, 0.1, 0.004, 0.006)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,shape\n", "has no column width_mm, height_mm, web_mm, flange_mm"),
        (HEADER + ",i,50,100,4,6\n", r"sizes.csv:2: has no name"),
        (HEADER + "A,u,50,100,4,6\n", r"sizes.csv:2: shape 'u' of A.* square, i, l, c"),
        (HEADER + "A,round,50,50,,\n", "shape 'round'"),
        (HEADER + "A,i,50,100,4,\n", "flange_mm is '', but must be millimetres above 0"),
        (HEADER + "A,i,50,wide,4,6\n", "height_mm is 'wide'"),
        (HEADER + "A,i,-50,100,4,6\n", "width_mm is '-50'"),
        (HEADER + "A,i,50,100,4,60\n", "web and flange of A do not fit"),
        (HEADER + '"A,i', "is not a CSV table"),
        ("", "has no column"),
    ],
)
def test_load_catalogue__says_what_is_wrong(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load_catalogue(written(tmp_path, text))


def test_load_catalogue__missing_file(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.csv: cannot be read: No such file"):
        load_catalogue(tmp_path / "none.csv")


def test_evidence_structure__refuses_a_missing_catalogue():
    config = load_config(overrides=["structure.shapes.catalogue=none.csv"])
    with pytest.raises(ConfigError, match=r"structure\.shapes\.catalogue"):
        EvidenceStructure(config, DepthNoise(0.01))


def test_evidence_structure__without_shapes_no_catalogue_is_read():
    overrides = ["structure.shapes={enabled: false, catalogue: none.csv}"]
    EvidenceStructure(load_config(overrides=overrides), DepthNoise(0.01))
