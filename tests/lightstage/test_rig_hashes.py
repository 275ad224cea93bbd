"""A rig's two hashes stay those of the files that labs keep."""

import hashlib
import json

from lightstage.rig import default_rig, rig_sha256
from lightstage.rig.file import rig_to_json
from lightstage.session import rig_hash


def test_journals_hash_a_rig_with_spaces_and_calibration_shots_without():
    rig = default_rig()
    spaced = json.dumps(rig_to_json(rig), sort_keys=True)
    dense = json.dumps(rig_to_json(rig), sort_keys=True, separators=(",", ":"))
    assert spaced.replace(", ", ",").replace(": ", ":") == dense
    assert rig_hash(rig) == hashlib.sha256(spaced.encode()).hexdigest()
    assert rig_sha256(rig) == hashlib.sha256(dense.encode()).hexdigest()


def test_the_hashes_of_the_default_rig_are_those_of_earlier_versions():
    found = rig_hash(default_rig())[:12], rig_sha256(default_rig())[:12]
    assert found == ("e120c498e6ce", "e3c1442370b4")
