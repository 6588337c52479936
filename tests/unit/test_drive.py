import subprocess
import sys

import pytest

from zsdist import drive
from zsdist.common import cli

HEAVY = ("torch", "ray", "pybullet", "scipy", "cryptography", "rich", "gymnasium", "matplotlib", "grpc", "onnx")


def parsed(*words):
    return drive.make_parser().parse_args(["bundle", "--connect", "tcp/h:7447", *words])


def test_the_defaults_are_those_of_the_design():
    options = parsed("--goal", "1", "-2.5")
    assert options.goal == [1.0, -2.5] and not options.arm
    assert (options.camera, options.odometry, options.command) == ("/camera/image/compressed", "/odom", "/cmd_vel")
    assert (options.domain, options.rate_hz, options.stop_after_s) == (0, 10.0, 0.5)


@pytest.mark.parametrize(
    "words",
    [
        ("--goal", "1"),
        ("--goal", "nan", "1"),
        ("--command", "a b"),
        ("--domain", "233"),
        ("--rate-hz", "1"),
        ("--stop-after-s", "0"),
        ("--max-speed-mps", "inf"),
        ("--camera-fov-deg", "180"),
    ],
)
def test_a_wrong_value_is_refused(words, capsys):
    with pytest.raises(SystemExit) as refused:
        parsed(*words)
    assert refused.value.code == cli.REFUSED and len(capsys.readouterr().err.splitlines()) == 1


def test_a_dead_mans_switch_without_arm_is_refused(tmp_path, capsys):
    words = [str(tmp_path), "--connect", "tcp/h:7447", "--goal", "1", "1", "--dead-man", "hold"]
    with pytest.raises(SystemExit) as refused:
        cli.execute(drive.main, drive.make_parser(), words)
    assert refused.value.code == cli.REFUSED and "--dead-man has no effect without --arm" in capsys.readouterr().err


def test_it_needs_nothing_that_only_training_has():
    code = f"import sys\nsys.modules.update(dict.fromkeys({HEAVY}))\nimport zsdist.drive"  # importing one of them fails
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
