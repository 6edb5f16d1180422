"""Independent simulator of joint logs: motions of an arm with positions, speeds, commands and motor torques.

`python -m analysis.world.motion OUT --logs 48 --seed 1` writes OUT/NNN (dataset.yaml and motion.csv.gz in
the format of joint logs) and OUT/truth/NNN.json. `--held-out` has reserved forms and causes,
`--causes` another set of causes, `--outside` the share of logs with one. It shares no code with the model
of `bayescal`.

`arms` has the arms and draws their true parameters, `dynamics` the torque, linear in the inertial parameters,
`plan` the motions, `noise` the autocorrelated noise and its whitening, `size` the baseline and the
detectability lambda, `effects` and `effects_drive` the effects of the list, `outside`, `outside_more`,
`outside_further` and `outside_third` the causes that are not in it, `mix` the kinds, `build` a log,
`rig` how it is measured, `write` its files. `servos` has logs of position servos without torques.
"""
