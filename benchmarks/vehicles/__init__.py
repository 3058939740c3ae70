"""Vehicles on a road: is what the simulation of their speed lacks named?"""
