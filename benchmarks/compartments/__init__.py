"""Substances in a body: is what the simulation of their concentration lacks named?"""
