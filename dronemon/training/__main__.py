"""`python -m dronemon.training`: what `dronemon train` does, as torchrun can start it."""

import typer

from dronemon.training.command import train_command

if __name__ == "__main__":
    typer.run(train_command)
