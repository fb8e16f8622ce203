"""The page of a study: tables, claims and figures."""
