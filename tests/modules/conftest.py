import pytest

from ppt_rl.modules import ProMP
from tests.sampling import normal, random_cov

K, D, DURATION = 6, 3, 2.5
SIZE = K * D


@pytest.fixture
def promp() -> ProMP:
    module = ProMP(K, D, DURATION).double()
    module.weights_mean.copy_(normal(K, D, seed=1))
    module.weights_cov.copy_(random_cov(size=SIZE, seed=2))
    return module
