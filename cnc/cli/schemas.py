"""The JSON Schemas that ``cncrun schema`` prints, by the names of their documents."""

from cnc.machine.height_map import height_map_schema
from cnc.machine.load import machine_schema
from cnc.machine.project import project_schema
from cnc.report.models import summary_schema
from cnc.session.checkpoint import checkpoint_schema

SCHEMAS = {
    "machine": machine_schema,
    "project": project_schema,
    "summary": summary_schema,
    "checkpoint": checkpoint_schema,
    "height-map": height_map_schema,
}
