"""Calibrate a simulation model (an FMU) with a PELS-VAE surrogate.

A study combines a case and a profile. The case declares the FMU, the parameters with their bounds, the
inputs, the measurement and the window. The profile sets the budget and the search space. `studies run` does
all stages in order:

  check         test the case and the speed of a simulation
  simulate      training, validation and test simulations
  sensitivity   Sobol indices per time step
  tune          Optuna chooses latent dimension, hidden width and beta of a PELS-VAE, one study per
                training-set size; each trial is an MLflow run that shows its curves during training
  calibrate     screen the box on the surrogate, polish on the FMU
  report        tables and figures on one page

`studies calibrate` alone needs no surrogate and the fewest simulations. After both, `studies uncertainty`
shows how sure the calibration is.

Examples:
  studies new Room.fmu                     a case file for your own FMU; then check, then calibrate
  studies calibrate                        the office, in fewest FMU calls, without a surrogate
  studies run                              the office with surrogates, quick profile: minutes on two cores
  studies run office-recorded --window 8-16
  studies check office                     what is wrong with a case, and what to do
  studies tune --n-train 64 --trials 40    more trials for one size; finished trials are kept
  studies calibrate --n-train 64 --json    one calibration from the stored surrogate
  studies status                           running trials, progress, time to go
  studies ui                               compare the runs in MLflow

The project is the nearest folder with a file studies.toml, from the working folder upwards. Without such a
file it is the working folder, and the first command that writes makes the file.

files of the project (label = <case>-<profile>):
  data/<case>/generated/    simulations          mlruns/reports/<label>/index.html    the report
  mlruns/results/<label>/   numbers              mlruns/artifacts/                    weights, pictures
  mlruns/mlflow.db          MLflow (studies ui)  mlruns/optuna.db                     Optuna

Finished work is not repeated. Interrupt any command, type it again, and it goes on.

exit codes:
  0    success
  1    a check or a stage failed, or the machine did (disk, memory)
  2    the input is wrong
  130  interrupted
  141  the reader of the output closed it
"""
