"""Events: the language of rules, their dispatch, the network that finds patterns, and the memories that keep them."""
