"""Files and folders: documents, run folders, locks, refusals, stopping."""
