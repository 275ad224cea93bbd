"""What may be called what: paths, control characters, other scripts, very long names."""

import json
import os
import unicodedata

import pytest

from lightstage.errors import ConfigError
from lightstage.session.pseudonym import check_pseudonym

REFUSED = {
    "path up": "../../etc/passwd",
    "path": "a/b",
    "absolute": "/tmp/x",
    "windows path": "..\\x",
    "e-mail": "someone@example.org",
    "nothing": "",
    "space": " ",
    "dot": ".",
    "hidden": ".hidden",
    "option": "-x",
    "line": "person\nsecond line",
    "bell": "person\a",
    "escape": "\x1b[31mred",
    "delete": "person\x7f",
    "next line": "person\u0085x",
    "right to left": "person\u202egnp",
    "isolate": "person\u2066x",
    "zero width": "per\u200bson",
    "byte order": "\ufeffperson",
    "line separator": "person\u2028x",
    "only a mark": "\u0301",
    "300 characters": "p" * 300,
    "65 characters": "p" * 65,
    "pictures": "\U0001f600",
}


def refused(said, text):
    assert f"--subject: found {text!a}, expected " in said
    assert "Use a pseudonym such as P07 or subject-12, never a name, an address or a path." in said
    # What is told cannot write to the operator's terminal.
    assert all(unicodedata.category(c) not in ("Cc", "Cf") or c == "\n" for c in said)


@pytest.mark.parametrize(
    "name", ["path up", "nothing", "escape", "right to left", "300 characters"]
)
def test_a_subject_that_could_harm_is_refused_and_nothing_is_made(bench, tools, name):
    done = bench.run(f"--subject={REFUSED[name]}")
    refused(tools.message(done, "ConfigError"), REFUSED[name])
    assert sorted(os.listdir(bench.desk)) == ["config.toml", "sim"]
    assert all(not state.counts.any() for state in bench.stage.device.states)


@pytest.mark.parametrize("name", REFUSED)
def test_no_such_subject_passes_the_check_that_every_command_makes(name):
    with pytest.raises(ConfigError) as error:
        check_pseudonym(REFUSED[name], "subject")
    refused(str(error.value), REFUSED[name])


TAKEN = {
    "accents": "Zoë7",
    "accents apart": unicodedata.normalize("NFD", "Zoë7"),
    "greek": "υποκείμενο-3",
    "chinese": "受试者12",
    "arabic": "شخص-4",
    "hyphens": "p_7.b-2",
    "64 characters": "p" * 64,
}


@pytest.mark.parametrize("name", ["accents apart", "arabic", "64 characters"])
def test_a_subject_in_any_script_is_kept_as_it_is_in_one_spelling(bench, name):
    done = bench.run("--subject", TAKEN[name], sequence="full")
    assert done.returncode == 0, done.stderr
    session = json.loads((bench.out / "session.json").read_text())
    assert session["subject"] == unicodedata.normalize("NFC", TAKEN[name])


def test_a_folder_of_any_name_takes_a_session(bench):
    out = bench.desk / "σεσσιόν ' \" $(x) ; 7"
    done = bench.run(out=out, sequence="full")
    assert done.returncode == 0, done.stderr
    assert len(list(out.glob("frames/full/cam*.dng"))) == 2


def test_a_folder_whose_name_no_disk_takes_is_refused_before_a_light_goes_on(bench, tools):
    done = bench.run(out=bench.desk / ("s" * 300))
    message = tools.message(done, "DiskError")
    assert "sss, --out: found a name of 300 bytes, expected at most" in message
    assert sorted(os.listdir(bench.desk)) == ["config.toml", "sim"]
    assert all(not state.counts.any() for state in bench.stage.device.states)


def test_patterns_of_no_meaning_are_all_refused_in_one_message_and_nothing_is_made(bench, tools):
    names = ["../x", "full\x1b[2J", "x" * 300, "ｆｕｌｌ", "x\u2212"]
    message = tools.message(bench.run(sequence=",".join(names)), "PatternError")
    assert message.count("found an unknown name") == len(names)
    assert "\x1b" not in message
    assert sorted(os.listdir(bench.desk)) == ["config.toml", "sim"]
