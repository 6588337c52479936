"""Settings of agents and recorders, read from a run's configuration; the agent itself knows only its own section."""

from zsdist.agent.hierarchy import AgentSettings
from zsdist.agent.recorder import RecorderSettings
from zsdist.config import Config
from zsdist.planning.grid import Grid
from zsdist.types import Level


def agent_settings(config: Config) -> AgentSettings:
    """Return the settings of an agent that drives under a configuration."""
    return AgentSettings(
        grid=Grid.from_config(config.grid),
        success_radius_m=config.sim.success_radius_m,
        camera_forward_m=config.camera.forward_m,
        policy=config.agent,
    )


def recorder_settings(config: Config) -> RecorderSettings:
    """Return the settings of a recorder of training episodes under a configuration."""
    return RecorderSettings(
        discounts={Level.HIGH: config.high.discount, Level.LOW: config.low.discount},
        literal_reward=config.reward.literal,
    )
