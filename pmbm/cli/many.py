"""Options that take several values after one name: `--classes Car Pedestrian`."""

from __future__ import annotations

import click


class ManyValues(click.Command):
    """A command whose `multiple` options also take their values one after another."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        repeatable = {
            name
            for parameter in self.params
            if isinstance(parameter, click.Option) and parameter.multiple
            for name in parameter.opts
        }
        spread: list[str] = []
        name: str | None = None
        fresh = False
        for argument in args:
            if argument.startswith("-") and argument != "-":
                name = argument if argument in repeatable else None
                fresh = True
            elif name is not None and not fresh:
                spread.append(name)
            else:
                fresh = False
            spread.append(argument)
        return super().parse_args(ctx, spread)
