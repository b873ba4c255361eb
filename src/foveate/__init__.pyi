from foveate.api import evaluate as evaluate
from foveate.api import load as load
from foveate.api import train as train
from foveate.beliefs import Belief as Belief
from foveate.results import Evaluation as Evaluation
from foveate.scenario import Scenario as Scenario
from foveate.scenes import Scene as Scene
from foveate.settings import PRESETS as PRESETS
from foveate.settings import Experiment as Experiment
from foveate.tracker import Tracker as Tracker
from foveate.trained_policy import TrainedPolicy as TrainedPolicy

__version__: str
