"""Attitudes whose columns are not w, x, y, z."""

import numpy as np

from capture_cli.log.checks.base import Check, warning
from capture_cli.model.quaternion_order import SETTINGS as QUATERNION_ORDER
from capture_cli.model.quaternion_order import is_w_last, order_in_names
from capture_cli.model.quaternion_signs import quaternion_columns


class QuaternionOrder(Check):
    """Attitudes whose columns are not w, x, y, z, by their names or, where these say nothing, by their values."""

    def findings(self, given):
        log, task = given.log, given.task
        if task.path is None:  # its columns are what they are
            return
        for own in quaternion_columns(task.model, [c.sensor for c in task.outputs]):
            sensor, columns = task.outputs[own[0]].sensor, [task.outputs[k].column for k in own]
            order, said = order_in_names(columns), ", and their names say {}"
            if order is None:
                values = log.outputs[np.ix_(log.sampled[:, own].all(axis=1), own)]
                is_last = is_w_last(values, task.model, sensor)
                order = QUATERNION_ORDER.w_last if is_last else QUATERNION_ORDER.w_first
                said = ": so the body is half a turn from upright throughout, and as {} it stays upright"
            if order != QUATERNION_ORDER.w_first:
                found = ", ".join("wxyz"[order.index(k)] for k in range(4))
                mended = ", ".join(f'"{columns[k]}"' for k in order)
                yield warning(
                    f"output {task.model.sensor(sensor).name}",
                    f"its columns, {', '.join(columns)}, are read as w, x, y, z{said.format(found)}",
                    f"write column = [{mended}] if that is their order, and import the files again",
                )
