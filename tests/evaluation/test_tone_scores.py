# SPDX-License-Identifier: Apache-2.0
"""How far a recovered tone curve lies from the true one, in stops."""

import pytest

from robir.maths import tone
from robir_bench.truth.light import stops_apart, tone_scores, true_curve


class Exposed(tone.StandardToneCurve):
    """Standard with everything three times as bright."""

    def linear_from_display(self, rgb_display):
        return 3.0 * super().linear_from_display(rgb_display)


def test_a_curve_is_no_stops_from_itself_and_exposure_does_not_count():
    for curve in tone.families():
        assert stops_apart(curve, curve) == 0.0
    assert stops_apart(Exposed(), tone.StandardToneCurve()) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("power", [0.5, 2.0])
@pytest.mark.parametrize("name", ["filmic", "standard", "robir_aces"])
def test_curves_recovered_from_retoned_inputs_are_consistent(name, power):
    """F2 = f(F1): what is found for re-toned inputs is f after what was found before."""
    before = {"family": name, "parameters": tone.curve_from_name(name).parameters}
    after = before | {"parameters": before["parameters"] | {"display_power": power}}
    retoned = {"view_transform": name, "display_power": power}
    assert tone_scores(after, retoned)["stops"] == 0.0
    assert tone_scores(before, retoned)["stops"] > 0.3
    assert tone_scores(before, {"view_transform": name})["stops"] == 0.0


def test_view_transforms_nobody_knows_have_no_score():
    assert true_curve({"view_transform": "Raw"}) is None
    found = {"family": "filmic", "parameters": {}}
    assert tone_scores(found, {"view_transform": "Raw"})["stops"] is None
    assert true_curve({"view_transform": "Khronos PBR Neutral"}).name == "khronos_pbr_neutral"
    assert true_curve({"view_transform": "Filmic", "look": "High Contrast"}) is None
    assert true_curve({"view_transform": "Filmic", "look": None}).name == "filmic"
    assert true_curve({"view_transform": "EMoR mean"}).name == "camera"
