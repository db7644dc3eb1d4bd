"""The doctor: is a case sound, what will it cost, and what to do about what is wrong."""

from studies.doctor.examination import examine
from studies.doctor.finding import Diagnosis, Finding, say_warnings, show_diagnosis

__all__ = ["Diagnosis", "Finding", "examine", "say_warnings", "show_diagnosis"]
