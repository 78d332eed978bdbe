"""A live view of a policy in a browser: the scene, sliders for its limits, and what its tank does."""

from ppt_rl.view.episodes import LiveEpisodes, Reading
from ppt_rl.view.server import LiveView
from ppt_rl.view.settings import Setting, changed_policy, settings_of

__all__ = ["LiveEpisodes", "LiveView", "Reading", "Setting", "changed_policy", "settings_of"]
