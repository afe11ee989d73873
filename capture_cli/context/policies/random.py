"""A policy that does not look: any action of the task is as likely as any other."""

from capture_cli.context.policies.base import Policy


class Random(Policy):
    summary = "uniform over the task's actions, whatever the parameters"

    def act(self, parameters, uniform):
        return self.task.draw_actions(uniform)
