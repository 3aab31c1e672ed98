from .controller import Controller as Controller
from .ilqr import Plan as Plan
from .lqr import Feedback as Feedback
from .lqr import Tracking as Tracking
