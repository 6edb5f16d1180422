"""A measuring session: the folder on disk and the `Dataset` in memory."""

from bayescal.dataset.read import read_dataset as read_dataset
from bayescal.dataset.types import ROLES as ROLES
from bayescal.dataset.types import Box as Box
from bayescal.dataset.types import Certificate as Certificate
from bayescal.dataset.types import Dataset as Dataset
from bayescal.dataset.types import Measurements as Measurements
from bayescal.dataset.types import Noise as Noise
from bayescal.dataset.types import Patch as Patch
from bayescal.dataset.types import PlanSettings as PlanSettings
from bayescal.dataset.types import Points as Points
from bayescal.dataset.types import Record as Record
from bayescal.dataset.types import Target as Target
from bayescal.dataset.types import Tool as Tool
from bayescal.dataset.write import write_dataset as write_dataset
