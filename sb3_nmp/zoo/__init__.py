"""RC-NMP and ACNMP in the RL Zoo (rl-zoo3): train, enjoy and tune by command line.

    python -m sb3_nmp.zoo train --algo rcnmp --env nmp/Bottles-v0
    python -m sb3_nmp.zoo enjoy --algo rcnmp --env nmp/Bottles-v0 -f logs --no-render
    python -m sb3_nmp.zoo train --algo rcnmp --env nmp/Bottles-v0 --optimize --n-trials 20

Everything after the first word is the Zoo's own. What is added: the two algorithms, their
hyper-parameters (``rcnmp.yml`` and ``acnmp.yml`` beside this file, taken unless ``--conf-file``
names another one), their samplers for Optuna, and the package that registers ``nmp/...``
environments. In these files and in ``--hyperparams``, a group of settings is a dictionary
(``mutation: {sigma: 0.5}``), and ``demonstrations`` is a number that the task's expert gives, or a
file (.npz or .csv).

``enjoy`` runs no code from a model's file. The Zoo itself reads ``args.yml`` of a run's folder such
that it can run code: enjoy only the runs of people whom you trust.
"""
