"""The danger network by its parts: shapes, gradients, what each looks at, and left and right."""

import torch

from tests.agents.danger.sights import Silent, all_of, lectures, small_config
from tests.support.samples import ACTIONS
from wcsim.agents.danger.network import DangerNet, channels_last, spec_of


def net_of(config) -> DangerNet:
    torch.manual_seed(0)
    return channels_last(DangerNet(spec_of(config)))


def test_it_gives_logits_and_every_weight_learns():
    config = small_config()
    net, lessons = net_of(config), lectures(config, 16)
    batch = lessons.batch(all_of(lessons)[:8])
    logits = net(*batch.inputs)
    assert logits.shape == (8, 81) and torch.isfinite(logits).all()
    torch.nn.functional.binary_cross_entropy_with_logits(logits, batch.unsafe).backward()
    assert not {name for name, value in net.named_parameters() if value.grad is None}


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
    config = small_config()
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
