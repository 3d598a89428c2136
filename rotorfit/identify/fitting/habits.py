"""Attributes that users of lmfit and statsmodels look for on a result, and where they are here."""

from __future__ import annotations

_BY_SENTENCE = {
    "best_fit fittedvalues": "the predicted readings are fit.problem.predict(fit.x), one array an experiment",
    "best_values popt values": "the estimates are {name: p.value for name, p in fit.params.items()}",
    "bse": "the standard error of each parameter is fit.params[name].stderr",
    "ci_report conf_int conf_interval": (
        "intervals are fit.params[name].interval(0.95), by the misfit fit.profile(name).interval"
    ),
    "correl correlations": "the covariance is fit.covar in the order of fit.var_names; fit.summary() has correlations",
    "cov_params pcov": "the covariance is fit.covar in the order of fit.var_names",
    "df_resid": "the degrees of freedom are fit.nfree",
    "errorbars": "fit.success says whether there are error bars, fit.params[name].stderr how large they are",
    "eval": "responses elsewhere are fit.predict(frequency, speed, force_plane=...)",
    "eval_uncertainty get_prediction": (
        "responses elsewhere with their bands are fit.predict(frequency, speed, force_plane=...)"
    ),
    "fit_report": "the table is fit.summary(), or print(fit)",
    "flatchain": "draws of the posterior are fit.sample(seed=1).samples",
    "init_values": "the start is {name: p.init_value for name, p in fit.params.items()}",
    "jac": "derivatives of the residuals are fit.problem.jacobian(fit.x)[1]",
    "llf": "there is no likelihood by itself: fit.aic, fit.bic and fit.chisqr compare fits",
    "nobs": "the number of real data is fit.ndata",
    "plot_fit": "figures are fit.plot.dynamic_stiffness(), fit.plot.bode() and fit.plot.polar()",
    "pvalues": "there are no p-values: intervals are fit.params[name].interval(0.95)",
    "resid residual": "residuals over their noise are fit.problem.residuals(fit.x), complex",
    "rsquared": "the agreement of each response is fit.responses, that of all fit.redchi",
    "tvalues": "there are no t-values: intervals are fit.params[name].interval(0.95)",
    "uvars": "parameters know their covariance, fit.params['K0'] / fit.params['D']; see to_uncertainties() of each too",
}
ELSEWHERE = {name: sentence for names, sentence in _BY_SENTENCE.items() for name in names.split()}
"""Sentence for each name that a result does not have."""
