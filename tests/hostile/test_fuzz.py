# SPDX-License-Identifier: Apache-2.0
"""A short fuzzing run of every target, seeded; `make fuzz` has the long one."""

from __future__ import annotations

import json
import random
import time

import pytest
from hostile.damage import NASTY, WHOLE, flipped, places, replaced
from hostile.targets import _POSES, MESHES, Targets
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

SECONDS = 0.7  # for each target; all of them stay below a minute

NAMES = (*_POSES, *("image", "status", "worker", "worker_log", "run", "manifest"))
NAMES += ("capture_json", "arrays", *MESHES, "plan_toml", "plan_json", "batch_json")
NAMES += ("light_exr", "light_hdr", "video")


@pytest.fixture(scope="module")
def targets(tmp_path_factory) -> Targets:
    return Targets(tmp_path_factory.mktemp("fuzz"))


def test_all_targets_are_fuzzed(targets):
    assert set(NAMES) == set(targets.calls)


@pytest.mark.parametrize("name", NAMES)
def test_what_once_crashed_and_seeded_damage(targets, name):
    call, seeds = targets.calls[name], targets.seeds[name]
    generator = random.Random(name)
    end = time.monotonic() + SECONDS
    for content in (*seeds, *WHOLE):
        call(content)
    while time.monotonic() < end:
        call(_mutant(generator.choice(seeds), generator))


def _mutant(seed: bytes, generator: random.Random) -> bytes:
    try:
        document = json.loads(seed)
    except ValueError:
        return flipped(seed, generator)
    if generator.random() < 0.3:
        return flipped(seed, generator)
    place = generator.choice(places(document))
    return replaced(document, place, generator.choice([*NASTY, ...])).encode()


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.parametrize(
    "name", ["nerfstudio", "polycam", "meshroom", "status", "run", "mesh_gltf"]
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_any_json_value_in_any_place(targets, name, data):
    document = json.loads(targets.seeds[name][0])
    place = data.draw(st.sampled_from(places(document)))
    targets.calls[name](replaced(document, place, data.draw(_JSON)).encode())
