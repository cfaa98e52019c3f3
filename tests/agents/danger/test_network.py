"""The danger network by its parts: shapes, gradients, what each looks at, and left and right."""

import pytest
import torch

from tests.agents.danger.sights import Silent, all_of, lectures, small_config
from tests.support.samples import ACTIONS
from wcsim.agents.danger.network import DangerNet, channels_last, spec_of
from wcsim.agents.networks.names import NETWORK_NAMES
from wcsim.errors import PolicyError

POINTS = torch.as_tensor(ACTIONS.points)


def net_of(config) -> DangerNet:
    torch.manual_seed(0)
    return channels_last(DangerNet(spec_of(config)))


@pytest.mark.parametrize("eye", ["map", "picture", "both"])
def test_each_eye_gives_logits_and_every_weight_learns(eye):
    config = small_config(f"danger.eye={eye}")
    net, lessons = net_of(config), lectures(config, 16)
    batch = lessons.batch(all_of(lessons)[:8])
    logits = net(*batch.inputs)
    assert logits.shape == (8, 81) and torch.isfinite(logits).all()
    torch.nn.functional.binary_cross_entropy_with_logits(logits, batch.unsafe).backward()
    without = {name for name, value in net.named_parameters() if value.grad is None}
    assert not without


@pytest.mark.parametrize("network", sorted(NETWORK_NAMES))
def test_every_network_of_the_registry_can_be_the_eye(network):
    config = small_config("danger.eye=picture", f"learn.network={network}")
    net, lessons = net_of(config), lectures(config, 12)
    batch = lessons.batch(all_of(lessons)[:4])
    assert batch.inputs[3].shape[1] == spec_of(config).net.window == (1 if network == "patch" else 4)
    assert net(*batch.inputs).shape == (4, 81)


def test_a_network_of_one_picture_cannot_see_a_window():
    with pytest.raises(PolicyError, match=r"env\.window=1"):
        net_of(small_config("danger.eye=picture", "learn.network=patch", "env.window=3"))


def test_a_picture_network_looks_at_pictures_and_a_map_network_does_not():
    for eye, looks in (("picture", True), ("both", True), ("map", False)):
        config = small_config(f"danger.eye={eye}")
        net, lessons = net_of(config).eval(), lectures(config, 8)
        street, vector, swept, frames = lessons.batch(all_of(lessons)).inputs
        other = torch.randint_like(frames, 0, 20)
        same = torch.equal(net(street, vector, swept, frames), net(street, vector, swept, other))
        assert same != looks, eye
        blank = torch.zeros_like(street)
        same = torch.equal(net(street, vector, swept, frames), net(blank, vector, swept, frames))
        assert same == (eye == "picture"), eye


def test_a_roll_out_head_that_knows_no_left_and_right_gives_mirrored_logits_for_a_mirrored_street():
    """Pictures, states and actions are turned together: only then the swept cells are the same ones."""
    config = small_config()
    net, lessons = net_of(config).eval(), lectures(config, 32)
    net.context = Silent()
    with torch.no_grad():
        net.roll_out.out.weight.zero_()  # cost maps from the map alone, by kernels that are alike on both sides
        net.roll_out.out.bias.zero_()
        fine = net.roll_out.fine.weight
        fine.copy_(fine + fine.flip(-1))
        for value in net.direct.parameters():
            value.zero_()
    rows = all_of(lessons)
    plain, turned = net(*lessons.batch(rows).inputs), net(*lessons.batch(rows, mirror=True).inputs)
    mirror = torch.as_tensor(ACTIONS.mirror)
    off = (plain[:, mirror] - turned).abs()
    assert off.mean() < 0.02 * plain.std(), "a place on the border of two cells may fall to either"
    assert (plain - turned).abs().mean() > 5 * off.mean(), "the street is not alike on both sides"


def test_the_position_of_the_stick_is_no_input():
    """Two wishes in the same street: the same logits for the same action, for there is nowhere to put a wish."""
    config = small_config("danger.eye=both")
    from tests.agents.danger.sights import a_segment
    from wcsim.agents.danger.dataset import Dataset

    segment = a_segment(8, ends=())
    told = []
    for stick in (0.9, -0.9):
        segment.wish[1:] = (0.0, stick)  # the first one tells who drove before the chair was seen
        lessons = Dataset(config)
        lessons.add(segment)
        told.append(net_of(config).eval()(*lessons.batch(all_of(lessons)).inputs))
    assert torch.equal(told[0], told[1])
