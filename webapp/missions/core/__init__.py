"""Poses, objects and conditions of missions: arrays and values, without files, database or network."""
