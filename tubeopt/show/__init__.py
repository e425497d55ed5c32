"""Answers for people: tables, JSON, pictures, the viewer."""
