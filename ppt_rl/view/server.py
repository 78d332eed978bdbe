"""The live view: a page in the browser that shows a policy acting, and lets one change its limits and its world."""

from __future__ import annotations

import time
from typing import Any

from ppt_rl.evaluation import Policy
from ppt_rl.functional.argument_checks import require_whole
from ppt_rl.training.extras import require_package
from ppt_rl.view.episodes import LiveEpisodes, Reading
from ppt_rl.view.plots import LivePlots
from ppt_rl.view.scene import SceneNodes
from ppt_rl.view.settings import Setting, settings_of

__all__ = ["LiveView"]

#: Control steps from one picture to the next, and from one drawing of the plots to the next.
_EVERY, _PLOTS_EVERY = 3, 12
#: How long the outcome of an episode is shown before the next one begins [s].
_BREAK = 0.7


class LiveView:
    """Serves the view of a policy until it is closed.

    Args:
        policy: the policy.
        host: address to listen at; ``"0.0.0.0"`` lets other machines look too.
        port: port to listen at; where it is taken, the next free one.
        seed: seed of the episodes.
        real_time: whether the world keeps to real time.

    Attributes:
        episodes: the world.
        sliders: handles of the sliders by name of the setting.
        pause: handle of the button that stops and continues the world.
        reset: handle of the button that begins the next episode.
        frames: how many pictures were sent.
        seconds: time in which they were sent, pauses left out [s].

    Raises:
        MissingPackage: if viser is not installed.
        ValueError: if the port is none.
    """

    def __init__(
        self, policy: Policy, *, host: str = "127.0.0.1", port: int = 8080, seed: int = 10_000, real_time: bool = True
    ) -> None:
        require_whole("port", port, 1, 65_535)
        require_package("viser", "view", "the live view")
        import viser

        self.episodes = LiveEpisodes(policy, seed=seed, on_step=self._on_step, real_time=real_time)
        self.server = viser.ViserServer(host=host, port=port, label=f"ppt_rl: {policy.variant}", verbose=False)
        self.frames, self.seconds = 0, 0.0
        self._last = time.perf_counter()
        self._break = _BREAK if real_time else 0.0
        self._number = 0
        self._nodes = SceneNodes(self.server)
        self._make_panel(policy)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    @property
    def rate(self) -> float:
        """Pictures sent per second so far."""
        return self.frames / self.seconds if self.seconds else 0.0

    def run(self, episodes: int | None = None) -> None:
        """Run episodes.

        Args:
            episodes: how many; None runs until the view is closed.
        """
        while not self.episodes.closed and (episodes is None or episodes > 0):
            success = self.episodes.run(self._began)
            if success is not None:
                self._status.content = self._said("**success**" if success else "**missed**")
                self._plots.draw()
                time.sleep(self._break)
            if episodes is not None:
                episodes -= 1

    def close(self) -> None:
        """End the present episode, and stop serving."""
        self.episodes.close()
        self.server.stop()

    # -- the panel ----------------------------------------------------------------------------------------------------

    def _make_panel(self, policy: Policy) -> None:
        gui = self.server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self._status = gui.add_markdown("")
        self.pause = gui.add_button("pause")
        self.reset = gui.add_button("reset")
        self.pause.on_click(self._on_pause)
        self.reset.on_click(lambda _: self.episodes.restart())
        self.speed = gui.add_slider("speed [-]", min=0.1, max=1.0, step=0.1, initial_value=1.0)
        self.speed.on_update(lambda _: setattr(self.episodes, "speed", float(self.speed.value)))
        with gui.add_folder("from the next episode on"):
            self.sliders = {setting.name: self._slider(setting) for setting in settings_of(policy)}
        self._plots = LivePlots(gui, dt=self.episodes.base.control_dt, has_tank=policy.recipe.has_tank)
        if self.episodes.has_obstacle:
            self._add_handle()

    def _slider(self, setting: Setting) -> Any:
        step = (setting.high - setting.low) / 200
        slider = self.server.gui.add_slider(
            setting.label, min=setting.low, max=setting.high, step=step, initial_value=setting.value
        )
        slider.on_update(lambda _: self.episodes.change(setting.name, float(slider.value)))
        return slider

    def _add_handle(self) -> None:
        """A handle on the table that the obstacle follows."""
        x, y = self.episodes.obstacle
        self.handle = self.server.scene.add_transform_controls(
            "/obstacle", scale=0.16, active_axes=(True, True, False), disable_rotations=True, position=(x, y, 0.12),
            translation_limits=((0.2, 0.85), (-0.4, 0.4), (0.12, 0.12)), depth_test=False,
        )  # fmt: skip

        @self.handle.on_update
        def _(_: Any) -> None:
            there = self.handle.position
            self.episodes.obstacle = (float(there[0]), float(there[1]))

    def _on_pause(self, _: Any) -> None:
        self.episodes.paused = not self.episodes.paused
        self.pause.label = "go on" if self.episodes.paused else "pause"

    # -- what happens -------------------------------------------------------------------------------------------------

    def _began(self) -> None:
        self._number += 1
        present = self.episodes.present.config
        self._plots.limits(p_max=present.p_max, e_max=getattr(present, "e_max", float("nan")))
        self._nodes.show(self.episodes.base.physics(0))
        self._status.content = self._said("")
        self._last = time.perf_counter()

    def _on_step(self, reading: Reading) -> None:
        self._plots.add(reading)
        if reading.step % _EVERY == 0:
            self._nodes.move(self.episodes.base.physics(0))
            now = time.perf_counter()
            if now - self._last < 1.0:  # a pause is longer
                self.frames, self.seconds = self.frames + 1, self.seconds + now - self._last
            self._last = now
        if reading.step % _PLOTS_EVERY == 0:
            self._plots.draw()

    def _said(self, outcome: str) -> str:
        return f"Episode {self._number}. {self.rate:.0f} pictures/s. {outcome}"
