"""Stability: of relative equilibria, of states along motions, of chaotic and periodic ones."""
