"""Bad command lines of ``ppt-rl``."""

from __future__ import annotations

from tests.bad_inputs.entry import BadCommand

__all__ = ["ENTRIES"]


def _cli(line: str, match: str, pending: bool = False) -> BadCommand:
    return BadCommand(tuple(line.split()), match, pending)


_NUMBER = "{} is {}; expected a whole number from"
_USAGE = [
    _cli("", "(missing|Missing|required|expected|choose|help)"),
    _cli("evalute ppt_push", "evalute"),
    _cli("evaluate", "POLICY|policy"),
    _cli("evaluate ppt_push --epsiodes 3", "epsiodes"),
    _cli("evaluate ppt_push --episodes", "episodes"),
    _cli("evaluate ppt_push --episodes many", "many"),
    _cli("evaluate ppt_push --episodes 2.5", "2.5"),
    _cli("evaluate ppt_push --seed lucky", "lucky"),
    _cli("evaluate ppt_push --num-envs", "num-envs"),
    _cli("evaluate ppt_push --json yes", "yes"),
    _cli("film", "POLICY|policy"),
    _cli("film ppt_push --fps 30", "fps"),
    _cli("calibrate-tank ppt_push --quantile most", "most"),
    _cli("study push --seeds three", "three"),
    _cli("study push --report-only yes --seeds 1", "yes"),
    _cli("sweep st_maze --episodes few", "few"),
    _cli("collide", "POLICY|policy"),
    _cli("collide pp_push --episodes few", "few"),
    _cli("policies --all", "all"),
    _cli("train", "VARIANT|variant"),
    _cli("train s_push --speed 3", "speed"),
    _cli("train s_push --p-max much", "much"),
    _cli("train s_push --box-sizes large", "large"),
    _cli("train s_push --ppo.epochs all", "all"),
]
_POLICIES = [
    _cli("evaluate nothing", "nothing does not exist; expected a checkpoint or a run's directory"),
    _cli("evaluate {tmp}/empty", "empty holds no checkpoint; expected a checkpoint"),
    _cli("evaluate {tmp}/file.txt", "file.txt cannot be read as a checkpoint .*[Uu]se another"),
    _cli("evaluate {tmp}/empty.torchrl", "empty.torchrl (cannot be read as|is not) a checkpoint"),
    _cli("evaluate {tmp}/short.torchrl", "short.torchrl cannot be read as a checkpoint .*[Uu]se another"),
    _cli("evaluate {tmp}/fly/policy", "recipe 'ppt_fly' is unknown; expected one of"),
    _cli("evaluate {tmp}/two/policy", "policy was written by another version.*p_max is 'two'|p_max is 'two'; expected"),
    _cli("evaluate {tmp}/torn", "was changed: its SHA-256 is .* Take a fresh copy"),
    _cli("evaluate ppt_push --recipe nothing", "recipe 'nothing' is unknown; expected one of"),
    _cli("evaluate ppt_push --recipe s_push", "is of variant 'ppt_push'; expected a recipe of it"),
    _cli("evaluate ppt_push --recipe {tmp}/broken.py", "broken.py cannot be run: SyntaxError: .*; expected a recipe"),
    _cli("evaluate ppt_push --recipe {tmp}/other.py", "other.py defines no recipe; expected RECIPE = Recipe"),
    _cli("evaluate ppt_push --recipe {tmp}/empty", "recipe '.*empty' is unknown; expected one of"),
    _cli("film nothing", "nothing does not exist; expected"),
    _cli("calibrate-tank nothing", "nothing does not exist; expected"),
    _cli("sweep st_maze nothing", "nothing does not exist; expected"),
    _cli("collide nothing", "nothing does not exist; expected"),
    _cli("collide ppt_maze --scenario blocked", "is a policy of the task 'maze', which has no collision .*; expected"),
    _cli("collide pp_push --scenario crash", "scenario 'crash' is unknown; expected one of .*blocked"),
    _cli("collide pp_push pp_push", "policies .* are given more than once; expected different ones"),
    _cli("collide pp_push --set physics_dt=0.001", "physics_dt is 0.001 s; expected at most 0.0005 s"),
    _cli("train nothing", "recipe 'nothing' is unknown; expected one of"),
    _cli("train {tmp}/broken.py", "broken.py cannot be run: SyntaxError"),
    _cli("train {tmp}/other.py", "other.py defines no recipe; expected"),
    _cli("study nothing", "recipe 'nothing' is unknown; expected one of"),
    _cli("study push ppt_maze", "recipes are of the tasks .*; expected recipes of one task"),
    _cli("sweep ppt_push", "expected policies of one task that has a sweep"),
]
_NUMBERS = [
    *(
        _cli(f"{command} {option} {value}", _NUMBER.format(option.lstrip("-").replace("-", "_"), value))
        for command in ("evaluate ppt_push", "calibrate-tank ppt_push", "film ppt_push")
        for option, value in (("--episodes", 0), ("--episodes", 10**12), ("--seed", -1), ("--num-envs", 0))
    ),
    _cli("evaluate ppt_push --num-envs 1000000000", "num_envs is 1000000000; expected a whole number from 1 to"),
    _cli("evaluate ppt_push --num-threads -1", "num_threads.*-1.*; expected"),
    _cli("evaluate ppt_push --film 0 --report {tmp}/empty", "film is 0; expected a whole number from 1 to 100"),
    _cli("calibrate-tank ppt_push --quantile 2", r"quantile is 2.0; expected a share in \(0, 1\]"),
    _cli("calibrate-tank ppt_push --quantile nan", "quantile is nan; expected a share"),
    _cli("calibrate-tank ppt_push --margin 0.5", "margin is 0.5; expected a factor of at least 1"),
    _cli("calibrate-tank ppt_push --margin inf", "margin is inf; expected a factor"),
    _cli("sweep st_maze --episodes 0", "episodes is 0; expected a whole number"),
    _cli("sweep st_maze --seed -1", "seed is -1; expected a whole number"),
    _cli("sweep st_maze --baseline nobody", r"baselines \['nobody'\] are unknown; expected names from"),
    _cli("study push --seeds 0", "seeds is 0; expected a whole number"),
    _cli("study push --episodes -1", "episodes is -1; expected a whole number"),
    _cli("study push --eval-seed 7 7", "seeds of the episodes are .7, 7.; expected .* each of them once"),
    _cli("study push --eval-seed -1", "eval_seed is -1; expected a whole number"),
    _cli("study push --num-envs 0", "num_envs is 0; expected a whole number"),
    _cli("train s_push --goal angle", "invalid choice .angle. for argument .--goal"),
    _cli("train s_push --hold-steps 0", "hold_steps is 0; expected"),
    _cli("train ppt_budget_push --budget-weight -1", "budget_weight is -1.0; expected a number from 0"),
    _cli("train ppt_budget_push --initial-share 1", "initial_share is 1.0; expected a number from"),
    _cli("train lagrangian_push --cost-limit -1", "cost_limit is -1.0; expected a number from 0"),
    _cli("train lagrangian_push --cost-limit 0", "cost_limit is 0 J; expected more"),
    _cli("train lagrangian_push --cost force", "invalid choice .force. for argument .--cost"),
    _cli("train lagrangian_push --pid.smoothing 1", "smoothing is 1.0; expected a number from 0 to 0.999"),
    _cli("train s_push --smoothing 1", "smoothing is 1.0; expected"),
    _cli("train ppt_push --counter-turn 9", "counter_turn is 9.0; expected"),
    _cli("train ppt_push --e-max 0", "e_max is 0.0; expected"),
    _cli("train s_push --duration 0", "duration is 0.0; expected"),
    _cli("train s_push --num-envs 0", "num_envs is 0; expected a whole number"),
    _cli("train s_push --num-threads -1", "num_threads.*-1.*; expected"),
    _cli("train s_push --physics-dt 0", "physics_dt is 0.0; expected"),
    _cli("train s_push --physics-dt 0.003", "control_dt=0.01 s is .* times physics_dt=0.003 s; expected"),
    _cli("train s_push --duration nan", "duration is nan; expected"),
    _cli("train s_push --p-max -1", "p_max is -1.0; expected"),
    _cli("train s_push --arm octopus", "arm 'octopus' is unknown; expected one of"),
    _cli("train s_push --box-sizes 0.5", "box_sizes is 0.5; expected a number from"),
    _cli("train s_push --stiffness 0", "stiffness.*0.0.*; expected"),
    _cli("train s_push --ppo.gamma 2", "gamma is 2.0; expected"),
    _cli("train s_push --ppo.epochs 0", "epochs is 0; expected"),
    _cli("train s_push --seed -1", "seed.*-1.*; expected"),
    _cli("train s_push --torch-threads 0", "torch_threads.*0.*; expected"),
    _cli("train s_push --num-envs 1000000000", "num_envs.*1000000000.*; expected"),
    _cli("train ppt_maze --follower-speed 0", "follower_speed is 0.0; expected"),
]
_SETTINGS = [
    _cli("evaluate ppt_push --set p_max", r"--set got \['p_max'\]; expected NAME=VALUE"),
    _cli("evaluate ppt_push --set =5", r"--set got \['=5'\]; expected NAME=VALUE"),
    _cli("evaluate ppt_push --set p_max=", r"--set got \['p_max='\]; expected NAME=VALUE"),
    _cli("evaluate ppt_push --set p_max=1 p_max=2", r"--set got \['p_max'\] more than once; expected one value"),
    _cli("evaluate ppt_push --set pmax=1", "option 'pmax' is unknown; expected one of"),
    _cli("evaluate ppt_push --set p_max=much", "option p_max is 'much'; expected float"),
    _cli("evaluate ppt_push --set p_max=nan", "p_max is nan; expected"),
    _cli("evaluate ppt_push --set p_max=-1", "p_max is -1.0; expected"),
    _cli("evaluate ppt_push --set e_max=inf", "e_max is inf; expected"),
    _cli("evaluate pp_push --set e_max=1", "option 'e_max' is unknown; expected one of"),
    _cli("evaluate ppt_push --set arm=octopus", "arm 'octopus' is unknown; expected one of"),
    _cli("evaluate ppt_push --set box_sizes=0.5", "box_sizes is 0.5; expected a number from"),
    _cli("evaluate ppt_push --set box_sizes=", r"--set got \['box_sizes='\]; expected"),
    _cli("evaluate ppt_push --set resume=maybe", "option resume is 'maybe'; expected bool"),
    _cli("evaluate ppt_push --set num_basis=8.5", "option num_basis is '8.5'; expected int"),
    _cli("evaluate ppt_push --set ppo.gama=1", "option 'gama' is unknown; expected one of .*'gamma'"),
    _cli("evaluate ppt_push --set ppo.gamma=2", "gamma is 2.0; expected"),
    _cli("evaluate ppt_push --set ppo=3", "option ppo is '3'; expected"),
    _cli("evaluate ppt_push --set p_max.x=3", "option 'p_max.x' is unknown.*; expected"),
    _cli("evaluate ppt_push --set stiffness=-1", "stiffness.*-1.*; expected"),
    _cli("evaluate ppt_push --set physics_dt=0", "physics_dt is 0.0; expected"),
    _cli("evaluate ppt_push --set control_dt=0.016", "duration is 1.5 s; expected a multiple of the control step"),
    _cli("evaluate st_maze --set layouts={tmp}/broken.json", "broken.json.*not valid JSON"),
    _cli("evaluate st_maze --set layouts={tmp}/far.json", "the maze lies .*; expected 0.3 to 0.7 m"),
    _cli("evaluate st_maze --set layouts={tmp}/none.json", "none.json.*(expected|Name)"),
    _cli("evaluate st_maze --set layouts={tmp}/empty", "empty.*(expected|Name)"),
    _cli("study s_push --set speed=1", "option 'speed' is unknown; expected one of"),
    _cli("study s_push --set p_max", r"--set got \['p_max'\]; expected NAME=VALUE"),
    _cli("study s_push --set p_max=much", "option p_max is 'much'; expected float"),
]
_OUTPUTS = [
    _cli("evaluate ppt_push --episodes 1 --report {tmp}/file.txt", "report is .*file.txt, .*; expected a folder"),
    _cli("evaluate ppt_push --episodes 1 --report /proc/nowhere", "report is /proc/nowhere, .*; expected a folder"),
    _cli("calibrate-tank ppt_push --episodes 1 --report {tmp}/file.txt/here", "report is .*; expected a folder"),
    _cli("film ppt_push --output film.avi", "output is film.avi; expected .* ends in .mp4 or .gif"),
    _cli("film ppt_push --output {tmp}/empty", "output is .*empty; expected the path of a file"),
    _cli("film ppt_push --output {tmp}/file.txt/film.mp4", "output is .*file.txt, .*; expected a folder"),
    _cli("study s_push --results {tmp}/file.txt", "results is .*file.txt, .*; expected a folder"),
    _cli("study s_push --runs {tmp}/file.txt --results {tmp}/empty", "runs is .*file.txt, .*; expected a folder"),
    _cli("study s_push --report-only --results {tmp}/empty", "no finished run under .*; leave --report-only out"),
    _cli("sweep st_maze --report {tmp}/file.txt", "report is .*file.txt, .*; expected a folder"),
    _cli(
        "train s_push --num-envs 1 --run-dir {tmp}/file.txt", "file.txt cannot be read or written: .*; check the path"
    ),
    _cli(
        "train s_push --num-envs 1 --run-dir /proc/nowhere",
        "/proc/nowhere cannot be read or written: .*; check the path",
    ),
    _cli(
        "train s_push --resume --run-dir {tmp}/short.torchrl",
        "short.torchrl (cannot be read|.*expected)",
    ),
]

ENTRIES = [*_USAGE, *_POLICIES, *_NUMBERS, *_SETTINGS, *_OUTPUTS]
