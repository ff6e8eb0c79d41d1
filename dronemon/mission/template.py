"""A mission file to start from, written from the schema: every key, its default, its meaning."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from dronemon.mission.schema import Mission, Target

_TARGETS = """\
  - {name: Bella, appearance: cow, prior_au: simulated}
  - {name: Zuri, appearance: zebra}"""


def mission_template() -> str:
    """Text of a mission that can be flown on the mock; keys without a default are comments."""
    lines = ["# One flight: area, drone, camera, targets, planner, and for the mock its world."]
    for key, field in Mission.model_fields.items():
        section = field.annotation
        if key == "targets":
            lines.append(f"\n{key}:  # {field.description}")
            lines += [f"  # {k}: {f.description}" for k, f in Target.model_fields.items()]
            lines.append(_TARGETS)
        elif isinstance(section, type) and issubclass(section, BaseModel):
            about = (section.__doc__ or "").split("\n")[0]
            lines.append(f"\n{key}:  # {about}")
            lines += [f"  {_line(k, f)}" for k, f in section.model_fields.items()]
        else:
            lines.append(_line(key, field))
    return "\n".join(lines) + "\n"


def _line(key: str, field: FieldInfo) -> str:
    """A key with its default, as a comment if it has none, and what it means."""
    default: Any = field.get_default(call_default_factory=True, validated_data={})
    given = f"# {key}:" if default is None else f"{key}: {json.dumps(default)}"
    return f"{given}  # {field.description}"
