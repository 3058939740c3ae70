"""Cells under pulses of current: is the relaxation that their simulation lacks found?"""
