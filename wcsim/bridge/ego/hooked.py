"""A seat's wheelchair as a user's step hook sees it."""

from __future__ import annotations

from wcsim.bridge.ego.ego import Ego
from wcsim.bridge.sumo.step_hook import HookChair
from wcsim.core.frames import sumo_from_yaw
from wcsim.towns.walking.routes import edges_ahead
from wcsim.types import Street


def hook_chair(seat: Ego, street: Street) -> HookChair:
    """The chair of a seat now."""
    plant, route, asks, (east_m, north_m, up_m) = seat.plant, seat.route, seat.asks, street.net_origin_m
    arc_m, (x, y, z) = seat.user.route_progress_m, plant.p_WB_m.tolist()
    ahead = [(x, y), *route.points_W_m[route.arc_m > arc_m].tolist()]
    return HookChair(
        seat=seat.index,
        p_net_m=(x + east_m, y + north_m, z + up_m),
        angle_deg=sumo_from_yaw(plant.yaw_rad),
        speed_mps=float(plant.v_B_mps[0]),
        way_net_m=tuple((px + east_m, py + north_m) for px, py in ahead),
        edges=edges_ahead(street.walk, route, arc_m),
        button_tls_id="" if asks is None else asks.tls_id,
    )
