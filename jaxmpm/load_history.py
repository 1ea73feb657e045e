"""A load against time, as a scene gives it."""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from jaxmpm.shapes import Number, Table


class History(Table):
    """A value against time, held after the last knot."""

    time: tuple[Number, ...] = Field(min_length=2, description="times of the knots, s")
    value: tuple[Number, ...] = Field(min_length=2, description="values at the knots, mm, N or MPa")
    interpolation: Literal["linear", "smooth"] = Field(
        "linear", description="between knots; smooth has neither speed nor acceleration at knots"
    )
    smooth_start: Annotated[Number, Field(ge=0.0)] = Field(
        0.0, description="how long the first change takes to reach its full rate, s"
    )

    @property
    def first_change(self) -> int:
        """Index of the first interval over which the value changes, 0 if it never does."""
        pairs = zip(self.value, self.value[1:], strict=False)
        return next((i for i, (a, b) in enumerate(pairs) if a != b), 0)

    @field_validator("time")
    @classmethod
    def _increasing(cls, time: tuple[float, ...]) -> tuple[float, ...]:
        if time[0] != 0.0 or any(b <= a for a, b in zip(time, time[1:], strict=False)):
            raise ValueError("times that start at 0 and increase, s")
        return time

    @field_validator("value")
    @classmethod
    def _as_many(cls, value: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        time = info.data.get("time", value)
        if len(value) != len(time):
            raise ValueError(f"as many values as there are times, {len(time)}")
        return value

    @field_validator("smooth_start")
    @classmethod
    def _fits(cls, smooth_start: float, info: ValidationInfo) -> float:
        if smooth_start == 0.0 or not {"time", "value", "interpolation"} <= info.data.keys():
            return smooth_start
        if info.data["interpolation"] != "linear":
            raise ValueError('0 with interpolation = "smooth", which starts smoothly by itself')
        history = cls.model_construct(**info.data)
        first = history.first_change
        interval = history.time[first + 1] - history.time[first]
        if smooth_start >= interval:
            raise ValueError(f"less than {interval:g}, the first interval with a change, s")
        return smooth_start
