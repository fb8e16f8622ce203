"""The measurements of a study, a stage each."""
