"""All records by name."""

from . import cell_records, houses, substances, vehicles
from .record import FieldRecord

RECORDS: dict[str, FieldRecord] = {
    each.name: each for field in (cell_records, houses, substances, vehicles) for each in field.RECORDS
}
"""Records by name, field by field."""
