"""The few Warp kernels that MuJoCo Warp does not have."""

import warp as wp


@wp.kernel
def save_sensors(sensordata: wp.array2d[float], saved: wp.array2d[float]):
  world, column = wp.tid()
  saved[world, column] = sensordata[world, column]


@wp.kernel
def restore_acceleration_sensors(
  saved: wp.array2d[float], is_acceleration: wp.array[bool], sensordata: wp.array2d[float]
):
  world, column = wp.tid()
  if is_acceleration[column]:
    sensordata[world, column] = saved[world, column]


@wp.kernel
def clear_worlds(mask: wp.array[bool], rows: wp.array2d[float]):
  world, column = wp.tid()
  if mask[world]:
    rows[world, column] = 0.0


@wp.kernel
def count_overflow(
  overflow: wp.array[int],
  nefc: wp.array[int],
  nacon: wp.array[int],
  ncollision: wp.array[int],
  seen: wp.array[int],
  wanted: wp.array[int],
):
  """ORs each world's sticky bits into `seen`; `wanted` keeps the largest (rows of a world, contacts, pairs)."""
  world = wp.tid()
  seen[world] = seen[world] | overflow[world]
  wp.atomic_max(wanted, 0, nefc[world])
  if world == 0:
    wp.atomic_max(wanted, 1, nacon[0])
    wp.atomic_max(wanted, 2, ncollision[0])
