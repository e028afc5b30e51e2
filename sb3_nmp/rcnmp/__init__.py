from sb3_nmp.rcnmp.rcnmp import RCNMP
__all__=["RCNMP"]
