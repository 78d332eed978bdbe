"""What pyproject.toml cannot say: recipes and published policies lie beside the package and are shipped in it."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["ppt_rl*"]), "ppt_rl.recipes", "ppt_rl.pretrained"],
    package_dir={"ppt_rl.recipes": "recipes", "ppt_rl.pretrained": "pretrained"},
    package_data={"ppt_rl": ["py.typed"], "ppt_rl.pretrained": ["*/card.json", "*/policy.safetensors"]},
)
