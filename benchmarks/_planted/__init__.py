"""The parts of the planted-effect benchmark: machines and logs, cases, effects outside the catalogue, judgement."""
