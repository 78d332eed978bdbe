"""Bad inputs and how each is refused: tables by kind of input, and one test that runs them all."""
