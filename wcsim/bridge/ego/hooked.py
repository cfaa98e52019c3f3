"""A seat's wheelchair as a user's step hook sees it."""

from __future__ import annotations

from wcsim.bridge.ego.ego import Ego
from wcsim.bridge.sumo.step_hook import HookChair
from wcsim.core.frames import sumo_from_yaw
from wcsim.types import Street, WalkEdge, WayKind


def hook_chair(seat: Ego, street: Street, origin_m: tuple[float, float]) -> HookChair:
    """The chair of a seat now; `origin_m` is the place of W's origin in the net."""
    plant, route, asks = seat.plant, seat.route, seat.asks
    begun = [arc_m <= seat.user.route_progress_m for arc_m in route.arc_m.tolist()].count(True)
    x, y, z = plant.p_WB_m.tolist()
    pieces = (street.walk.edges[edge] for edge in route.edge_index[max(0, begun - 1) :].tolist())
    ahead = [(x, y), *map(tuple, route.points_W_m[begun:].tolist())]
    return HookChair(
        seat=seat.index,
        p_net_m=(x + origin_m[0], y + origin_m[1], z + street.net_z_m),
        angle_deg=sumo_from_yaw(plant.yaw_rad),
        speed_mps=float(plant.v_B_mps[0]),
        way_net_m=tuple((px + origin_m[0], py + origin_m[1]) for px, py in ahead),
        edges=tuple(dict.fromkeys(map(_edge_id, pieces))),
        button_tls_id="" if asks is None else asks.tls_id,
    )


def _edge_id(piece: WalkEdge) -> str:
    """SUMO's edge; of pavements and crossings the walk graph knows the lane."""
    return piece.sumo_id if piece.kind is WayKind.WALKINGAREA else piece.sumo_id.rpartition("_")[0]
