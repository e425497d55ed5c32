"""The commands of the command line, a module per group. Each turns flags into a question, and an answer into text."""
