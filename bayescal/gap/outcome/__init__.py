"""What a diagnosis reports: size of the gap, locations, margins, model levels, reduction."""
