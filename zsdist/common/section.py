"""Group of settings, from which all groups of the configuration derive."""

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator

from zsdist.common import values


class Section(BaseModel):
    """Group of settings. It is frozen and accepts neither unknown keys nor NaN nor infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _typed(cls, value: Any, info: ValidationInfo) -> Any:
        return values.typed(cls.model_fields[str(info.field_name)].annotation, value)
