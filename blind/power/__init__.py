"""How small a change, and which faults of logs, a diagnosis finds: faults put into flights."""
