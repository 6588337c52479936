"""`python -m zsdist.scenes`: make, check and draw scenes, and turn maps of Nav2 into scenes and back."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zsdist.common import cli, commands, output_files, places, random_streams
from zsdist.common.console import say
from zsdist.errors import SceneError
from zsdist.sim.scenes import families, scene
from zsdist.sim.scenes.diagnosis import diagnose
from zsdist.sim.scenes.kinds import GROUNDS
from zsdist.sim.scenes.scene import DEFAULT_GRID, Start

FAULTY = 1  # exit status of `check` where a scene is invalid or has no way


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.scenes", description=__doc__)
    orders = parser.add_subparsers(dest="order", required=True, metavar="ORDER", parser_class=cli.Parser)
    _add_generate(orders)
    what = "scene files, or folders of them"
    check = orders.add_parser("check", help="say whether the car can reach the goal, and where it is too narrow")
    check.add_argument("paths", nargs="+", type=cli.path, metavar="PATH", help=what)
    check.add_argument("--out", type=cli.path, metavar="FILE.png", help="draw ways and narrow places (PNG, SVG or PDF)")
    check.add_argument("--json", type=cli.path, metavar="FILE", help="write the findings to FILE")
    draw = orders.add_parser("draw", help="draw scenes from above, all on one sheet")
    draw.add_argument("paths", nargs="+", type=cli.path, metavar="PATH", help=what)
    drawn = "picture to write: PNG, SVG or PDF"
    draw.add_argument("--out", type=cli.path, required=True, metavar="FILE.png", help=drawn)
    _add_from_map(orders)
    _add_to_map(orders)
    for each in orders.choices.values():  # `execute` adds it before the order only
        each.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help="show the traceback of an error"
        )
    return parser


def _add_generate(orders: Any) -> None:
    add = orders.add_parser("generate", help="write scenes of a family").add_argument
    add("family", metavar="FAMILY", help=f"one of {', '.join(families.FAMILIES)}")
    add("--count", type=cli.count, default=1, metavar="N", help="number of scenes (default: 1)")
    add("--seed", type=cli.natural, default=0, metavar="S", help="seed of the first; the next ones follow (default: 0)")
    add("--out", type=cli.path, required=True, metavar="DIR", help="folder of the scene files; made if missing")


def _add_from_map(orders: Any) -> None:
    add = orders.add_parser("from-map", help="write scenes of a map of Nav2 (map_server)").add_argument
    add("map", type=cli.path, metavar="MAP.yaml", help="YAML file of the map; its picture is PGM, PNG or BMP")
    add("--out", type=cli.path, required=True, metavar="DIR", help="folder of the scene files; made if missing")
    count = "number of scenes (default: one for each part of the map, of the arena's size)"
    add("--count", type=cli.count, metavar="N", help=count)
    add("--seed", type=cli.natural, default=0, metavar="S", help="seed of starts and goals (default: 0)")
    unknown = "what unknown cells are; default: as Nav2 reads them, and free where it says unknown"
    add("--unknown", choices=("free", "occupied"), help=unknown)
    lethal = "least occupancy of an obstacle, 1 to 100, Nav2's lethal_cost_threshold (default: 100)"
    add("--lethal", type=cli.count, default=100, metavar="N", help=lethal)
    start = "start of the only scene, in the map's frame; with --goal"
    add("--start", nargs=3, type=_metres, metavar=("X", "Y", "HEADING_DEG"), help=start)
    add("--goal", nargs=2, type=_metres, metavar=("X", "Y"), help="goal of the only scene, in the map's frame")
    add("--ground", choices=tuple(GROUNDS), default="asphalt", help="kind of ground (default: asphalt)")


def _add_to_map(orders: Any) -> None:
    add = orders.add_parser("to-map", help="write a scene as a map of Nav2").add_argument
    add("paths", nargs="+", type=cli.path, metavar="SCENE", help="scene files, or folders of them")
    add("--out", type=cli.path, required=True, metavar="DIR", help="folder of the maps; made if missing")
    cell = "side of a cell (default: 0.01; Nav2's usual 0.05 moves walls by up to 2.5 cm)"
    add("--resolution-m", type=_metres, default=0.01, metavar="M", help=cell)
    add("--format", choices=("png", "pgm"), default="png", help="format of the picture (default: png)")


def main(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    orders = {"generate": _generate, "check": _check, "draw": _draw, "from-map": _from_map, "to-map": _to_map}
    return orders[options.order](options)


def _generate(options: argparse.Namespace) -> int:
    if line := places.find_clash("FAMILY", options.family, families.FAMILIES):
        say(line, error=True)
    made = [families.generate(options.family, options.seed)]  # refuses a wrong family before the folder is made
    with output_files.made_folder(f"--out {options.out}", options.out):
        for index in range(options.count):
            if index:
                made.append(families.generate(options.family, options.seed + index))
            scene.write(made[-1], options.out / f"{made[-1].name}.yaml")
    say(f"{_counted(made)} in {options.out}")
    _suggest(options.out)
    return 0


def _check(options: argparse.Namespace) -> int:
    if options.out is not None:
        _check_picture(options.out)
    if options.json is not None:
        output_files.check_writable("--json", options.json)
    rows: list[dict[str, Any]] = []
    scenes, diagnoses = [], []
    for path in _files(options.paths):
        try:
            found = scene.read(path)
        except SceneError as error:
            say(f"invalid  {error}")
            rows.append({"file": str(path), "valid": False, "reason": str(error)})
            continue
        diagnosis = diagnose(found)
        scenes.append(found)
        diagnoses.append(diagnosis)
        solved = diagnosis.reason is None
        narrowest = f", narrowest {diagnosis.narrow[0]}" if solved and diagnosis.narrow else ""
        about = f"{diagnosis.way_m:.1f} m{narrowest}" if solved else diagnosis.reason
        say(f"{'ok' if solved else 'no way':8} {found.name}: {about}")
        rows.append(
            {
                "file": str(path),
                "valid": True,
                "scene": found.name,
                "solvable": solved,
                "shortest_m": round(diagnosis.way_m, 4) if math.isfinite(diagnosis.way_m) else None,
                "reason": diagnosis.reason,
                "narrow": [
                    {"x_m": round(place.x_m, 3), "y_m": round(place.y_m, 3), "width_m": round(place.width_m, 3)}
                    for place in diagnosis.narrow
                ],
            }
        )
    bad = sum(not row.get("solvable", False) for row in rows)
    say(f"{_counted(rows)}: {len(rows) - bad} can be driven, {bad} cannot")
    if options.json is not None:
        output_files.write_json("--json", options.json, {"scenes": rows})
    if options.out is not None and scenes:
        from zsdist.reporting.scene_sheet import draw_sheet  # imports matplotlib, which the rest does not need

        with output_files.written(f"--out {options.out}"):
            draw_sheet(scenes, DEFAULT_GRID, options.out, diagnoses)
        say(f"drawn: {options.out}")
    elif bad and scenes:
        command = commands.module("zsdist.scenes", "check", *options.paths, "--out", "check.png")
        say(f"to see where: {command}")
    return FAULTY if bad else 0


def _draw(options: argparse.Namespace) -> int:
    from zsdist.reporting.scene_sheet import draw_sheet

    _check_picture(options.out)
    scenes = [scene.read(path) for path in _files(options.paths)]
    with output_files.written(f"--out {options.out}"):
        draw_sheet(scenes, DEFAULT_GRID, options.out)
    say(f"{_counted(scenes)} drawn: {options.out}")
    return 0


def _from_map(options: argparse.Namespace) -> int:
    from zsdist.sim.maps import nav2
    from zsdist.sim.maps.scenes import LEAST_WAYS_M, ObstacleRules, scene_between, scenes_of

    if (options.start is None) != (options.goal is None):
        raise SceneError("--start and --goal go together; give both or neither")
    if options.start is not None and options.count not in (None, 1):
        raise SceneError(f"--count {options.count}: with --start and --goal there is one scene; remove the option")
    if options.lethal > nav2.OCCUPIED:
        raise SceneError(f"--lethal is {options.lethal}; allowed is 1 to {nav2.OCCUPIED}")
    found = nav2.read(options.map)
    _tell_about(found, options.unknown)
    reading = ObstacleRules(options.unknown == "occupied", options.lethal)
    if options.start is not None:
        x_m, y_m, heading_deg = options.start
        goal = (options.goal[0], options.goal[1])
        made = [scene_between(found, reading, Start(x_m, y_m, heading_deg), goal, options.ground)]
        unusable: list[tuple[float, float]] = []
    else:
        rng = random_streams.map_scenes(options.seed)
        made, unusable = scenes_of(found, reading, options.count, rng, options.ground)
    with output_files.made_folder(f"--out {options.out}", options.out):
        for one, window in made:
            x_m, y_m = window.centre
            comment = (
                f"from {options.map.name!r}; (0, 0) is ({x_m:g}, {y_m:g}) of the map's frame; the axes are its own"
            )
            scene.write(one, options.out / f"{one.name}.yaml", comment)
            if window.tolerance_m > 0.05:
                within = f"its obstacles are within {window.tolerance_m:g} m of it, not 0.05"
                say(f"note: {one.name}: the map is ragged; {within}")
            apart_m = math.hypot(one.start.x_m - one.goal[0], one.start.y_m - one.goal[1])
            if apart_m < LEAST_WAYS_M[0]:
                room = f"there is no room for {LEAST_WAYS_M[0]:g} m"
                say(f"note: {one.name}: start and goal are only {apart_m:.1f} m apart; {room}")
    for x_m, y_m in unusable:
        say(f"note: around ({x_m:g}, {y_m:g}) there are no start and goal with a way between them")
    say(f"{_counted(made)} in {options.out}, {sum(len(one.obstacles) for one, _ in made)} obstacles")
    _suggest(options.out)
    return 0


def _tell_about(found: Any, unknown: str | None) -> None:
    """Say what a reader of the map may not expect: unknown cells, and a turned origin."""
    width_m, height_m = found.size_m
    doubtful, not_known, whole = int(found.doubtful.sum()), int((found.cells < 0).sum()), found.cells.size
    say(f"{found.name}: {width_m:.1f} m x {height_m:.1f} m, {found.resolution_m:g} m a cell")
    if doubtful and unknown is None:
        say(
            f"note: {_share(doubtful, whole)} of the cells have the grey 205, which map_saver writes for unknown "
            "cells, but this map's free_thresh makes them free, in Nav2 and here; --unknown occupied makes them "
            "obstacles"
        )
    if not_known and unknown is None:
        share = _share(not_known, whole)
        say(f"note: {share} of the cells are unknown, and taken as free; --unknown occupied makes them obstacles")
    if found.origin[2]:
        turn = math.degrees(found.origin[2])
        say(f"note: the map is turned by {turn:.1f} degrees; Nav2's static layer ignores this, the scenes do not")


def _to_map(options: argparse.Namespace) -> int:
    from zsdist.sim.maps import nav2
    from zsdist.sim.maps.scenes import occupied_cells

    cells = DEFAULT_GRID.arena_m / options.resolution_m if options.resolution_m > 0 else 0.0
    if not 0.005 <= options.resolution_m <= 1.0 or abs(cells - round(cells)) > 1e-6:
        raise SceneError(
            f"--resolution-m is {options.resolution_m:g}; allowed is 0.005 to 1 m, a whole number of times in "
            f"{DEFAULT_GRID.arena_m:g} m, such as 0.01, 0.02, 0.025 or 0.05"
        )
    half = DEFAULT_GRID.arena_m / 2
    scenes = [scene.read(path) for path in _files(options.paths)]
    with output_files.made_folder(f"--out {options.out}", options.out):
        for one in scenes:
            file = options.out / f"{one.name}.yaml"
            nav2.write(
                occupied_cells(one, options.resolution_m), options.resolution_m, (-half, -half), file, options.format
            )
    say(f"{_counted(scenes, 'map')} in {options.out}; the arena's walls are the edges of the picture")
    walkers = sum(len(one.walkers()) for one in scenes)
    if walkers:
        say(f"note: {walkers} walking people are left out; a map has only what stands")
    one = scenes[0]
    ends = ["--start", *map(str, (one.start.x_m, one.start.y_m, one.start.heading_deg)), "--goal", *map(str, one.goal)]
    back = commands.module("zsdist.scenes", "from-map", options.out / f"{one.name}.yaml", "--out", "DIR", *ends)
    say(f"back to a scene: {back}")
    return 0


def _files(paths: Sequence[Path]) -> list[Path]:
    """Return scene files, and those of folders, in order; raise `SceneError` for a path that is neither."""
    return [file for path in paths for file in scene.files(path)]


def _check_picture(file: Path) -> None:
    from zsdist.reporting.scene_sheet import SUFFIXES

    if file.suffix.lower() not in SUFFIXES:
        raise SceneError(f"--out is {str(file)!r}; allowed is a picture named *{', *'.join(SUFFIXES)}")
    output_files.check_writable("--out", file)


def _suggest(folder: Path) -> None:
    say(f"look at them: {commands.module('zsdist.scenes', 'draw', folder, '--out', 'scenes.png')}")
    say(f"drive in them: {commands.module('zsdist.evaluate', 'pretrained', '--scenes', folder)}")


def _counted(items: Sequence[object], what: str = "scene") -> str:
    return f"{len(items)} {what}{'' if len(items) == 1 else 's'}"


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f}%"


def _metres(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is a number")
    return value


if __name__ == "__main__":
    cli.execute(main, make_parser())
