"""The linear problem behind a diagnosis: residuals, columns, evidence, masses."""
