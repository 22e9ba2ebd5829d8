"""The pipelines of [SLAPSE] and [MVO] as their pages print them; docs/papers.md tells the rest."""
