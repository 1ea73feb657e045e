"""A run in numbers: what summary.json says."""

import jax
import numpy as np

from jaxmpm.homogenise import homogenised

ENERGIES = (
    "external_work", "stored_energy", "kinetic_energy", "dissipated_energy", "damping_work",
    "contact_work",
)  # fmt: skip


def summarise(recorder, status: str) -> dict:
    """The run of a `run.Recorder` so far: N, mm, N·mm, s."""
    sim, scene, moves = recorder.sim, recorder.scene, recorder.moves
    steps = int(sim.state.step) + (sim.steps_before if moves else 0)
    cells = int((sim.layout.material >= 0).sum())
    out = {
        "scene": scene.name, "title": scene.title, "status": status,
        "cell_size": scene.grid.cell, "thickness": scene.grid.thickness,
        "cells": cells, "can_crack": recorder.can_crack, "cracked": sim.cracked(), "steps": steps,
        "frame": _frame_name(recorder),
    }  # fmt: skip
    if scene.grid.half:  # of which `cells` and `cracked` are told
        out["half"] = scene.grid.half
    if scene.mesostructure:
        out["phases"] = sim.layout.shares()
    if moves:
        out |= {"points": sim.count(), "points_left": sim.left, "hand_over_time": recorder.handed_over}
    if recorder.static:
        out |= {"quasistatic": sim.report()}
    if recorder.rise is not None:
        out |= {"elastic_rise_steps": min(recorder.rise.last, sim.steps_before if moves else steps)}  # points go on in motion
    if moves or recorder.static or recorder.rise is not None:
        out |= {"messages": recorder.messages}
    if scene.response and recorder.rows:
        out |= _of_response(recorder)
    if scene.macro and recorder.rows:
        out["homogenised"] = homogenised(scene, recorder.table())
    last = dict(zip((name for name, _ in recorder.columns), recorder.rows[-1])) if recorder.rows else {}
    out |= {name: last.get(name) for name in (*ENERGIES, "energy_error", "time")}
    worst = max((abs(row[-2]) for row in recorder.rows), default=None)
    return out | {
        "largest_energy_error": worst,
        "time_step": sim.dt, "stable_time_step": sim.stable_dt,
        "time_step_factor": scene.solver.time_step_factor,
        "wall_seconds": recorder.wall_seconds(), "run_seconds": sim.run_seconds,
        "compile_seconds": sim.compile_seconds,
        "ms_per_step": 1e3 * sim.run_seconds / max(steps, 1),
        "cell_steps_per_second": cells * steps / sim.run_seconds if sim.run_seconds else None,
        "precision": scene.solver.precision, "device": jax.devices()[0].device_kind,
    }  # fmt: skip


def _frame_name(recorder) -> str:
    """The frame of the run, in words."""
    if not recorder.moves:
        return "total"
    return "updated" if recorder.handed_over is None else "total, then updated"


def _of_response(recorder) -> dict:
    """Peak and end of the response, and how it lies to what was measured."""
    response, table = recorder.scene.response, recorder.table()
    load, displacement = table[response.load], table[response.displacement]
    peak = int(np.nanargmax(np.abs(load))) if np.isfinite(load).any() else 0
    out = {"response": response.model_dump(include={"load", "displacement"})}
    out["load_unit"], out["displacement_unit"] = recorder.units()
    out |= {"peak_load": load[peak], "displacement_at_peak": displacement[peak]}
    out |= {"final_load": load[-1], "final_displacement": displacement[-1]}
    if not recorder.static:  # small where a response in motion is quasi-static
        stored, kinetic = table["stored_energy"][peak], table["kinetic_energy"][peak]
        out["kinetic_share_at_peak"] = kinetic / stored if stored > 0 else None
    if reference := response.reference:
        out["reference"] = reference.file
        if reference.is_band:
            out["reference_inside"] = reference.share_inside(displacement, load)
    return out
