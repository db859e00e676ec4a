"""Forwarding of outputs to a broker of MQTT, with a queue on the disk for times without a network."""
