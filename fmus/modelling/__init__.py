"""The language models are written in: variables, states, functions and what is derived from them."""
