"""Algorithms: a problem in, a raw solution and its status out."""
