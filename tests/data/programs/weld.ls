/PROG  WELD
/ATTR
COMMENT		= "P[1] X = 1.0 mm";
/MN
   1:J P[2] 100% FINE    ;
   2:L P[1:start] 500mm/sec FINE    ;
   3:L PR[5] 500mm/sec FINE    ;
/POS
P[1:"start"]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   450.000  mm,	Y =      .000  mm,	Z =   200.000  mm,
	W =  -180.000 deg,	P =      .000 deg,	R =      .000 deg
   GP2:
	UF : 0, UT : 1,	
	J1=   100.000  mm
};
P[2]{
   GP1:
	UF : 3, UT : 1,	
	J1=     5.000 deg,	J2=    10.000 deg,	J3=   -15.500 deg,
	J4=     2.000 deg,	J5=   -70.000 deg,	J6=      .500 deg
};
/END
